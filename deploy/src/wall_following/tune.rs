//! `zenav tune wall_follow`: searches for the wall follower's gains in generated rooms, and reports the improvement in rooms unseen by the
//! search.
//!
//! The cost of gains in a room is the root mean square of the distance error (m), by the simulator's ground truth, along all walls and
//! corners, from the first time near the target distance on; every contact costs another metre, and time not spent along walls costs too.
//! All candidates drive in the same rooms with the same noise, in parallel threads; the result does not depend on the number of threads.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use indicatif::ProgressBar;
use serde::Serialize;
use zenav_protocol::robot::RobotModel;
use zenav_sim::World;

use super::chart;
use super::evolution::Evolution;
use super::lockstep;
use super::rooms::room;
use crate::arguments::{self, positive};
use crate::batch::progress;
use crate::completion;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{self, Format};
use crate::parallel;

/// Standard deviation of the first generation, in logarithms of the gains.
const SIGMA: f64 = 0.5;
/// Start value of a gain of zero, which has no logarithm.
const LEAST_GAIN: f64 = 0.01;
/// Largest gain.
const MOST_GAIN: f64 = 200.0;
/// Gaps in the rooms, in target distances: the robot fits through with a wall on both sides.
const GAP: f64 = 3.4;
/// Share of the time along walls above which there is no cost.
const FOLLOWING: f64 = 0.6;
/// Offset of the seeds of unseen rooms from those of the search.
const UNSEEN: u64 = 500_000;

/// Search for parameters.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav tune wall_follow --robot neato\n  zenav tune wall_follow --rooms 4 --generations 5 --out quick"
)]
pub struct TuneArgs {
    #[command(subcommand)]
    command: TuneCommand,
}

#[derive(Debug, Subcommand)]
enum TuneCommand {
    /// Search for the gains of the wall follower; writes a robot file
    #[command(name = "wall_follow", alias = "wall-follow")]
    WallFollow(WallFollowArgs),
}

#[derive(Debug, Args)]
struct WallFollowArgs {
    /// Robot to tune: a robot file or shipped name
    #[arg(long, default_value = "neato", add = completion::models())]
    robot: String,
    /// Number of rooms to search in, and of other rooms to judge in
    #[arg(long, default_value_t = 8, value_parser = arguments::whole_in(1..=1000_u32))]
    rooms: u32,
    /// Generations of the search
    #[arg(long, default_value_t = 14, value_parser = arguments::whole_in(1..=1000_u32))]
    generations: u32,
    /// Candidates per generation
    #[arg(long, default_value_t = 8, value_parser = arguments::whole_in(4..=1000_u32))]
    population: u32,
    /// Simulated time in each room, s
    #[arg(long, default_value_t = 90.0, value_name = "SECS", value_parser = positive)]
    time: f64,
    /// Seed of rooms, noise and search
    #[arg(long, default_value_t = 1, value_parser = arguments::whole::<u64>)]
    seed: u64,
    /// Parallel simulations [default: one per core]
    #[arg(long, value_parser = arguments::whole_in(1..=1024_u32))]
    threads: Option<u32>,
    /// Folder for the robot file, `report.json` and `tuning.svg`
    #[arg(long, default_value = "zenav-tune")]
    out: PathBuf,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// The tuned gains.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gains {
    /// Proportional gain on the distance error.
    pub wall_p: f64,
    /// Integral gain.
    pub wall_i: f64,
    /// Derivative gain.
    pub wall_d: f64,
}

impl Gains {
    fn of(model: &RobotModel) -> Self {
        let wall = &model.wall_following;
        Self {
            wall_p: wall.wall_p,
            wall_i: wall.wall_i,
            wall_d: wall.wall_d,
        }
    }

    fn logarithms(self) -> [f64; 3] {
        [self.wall_p, self.wall_i, self.wall_d].map(|gain| gain.max(LEAST_GAIN).ln())
    }

    fn of_logarithms(logarithms: &[f64]) -> Self {
        let gain = |index: usize| logarithms.get(index).map_or(0.0, |log| log.exp().min(MOST_GAIN));
        Self {
            wall_p: gain(0),
            wall_i: gain(1),
            wall_d: gain(2),
        }
    }

    fn on(self, model: &RobotModel) -> RobotModel {
        let mut model = model.clone();
        let wall = &mut model.wall_following;
        (wall.wall_p, wall.wall_i, wall.wall_d) = (self.wall_p, self.wall_i, self.wall_d);
        model
    }
}

/// Cost of gains in a room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Judged {
    /// Cost.
    pub cost: f64,
    /// Root mean square of the distance error, m.
    pub rms_m: f64,
    /// 95th percentile of the absolute error on straight walls, m.
    pub straight_p95_m: f64,
    /// Contacts.
    pub collisions: u32,
}

/// A room unseen by the search, with the gains before and after.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct UnseenRoom {
    /// Name of the room.
    pub room: String,
    /// With the gains of the robot's file.
    pub before: Judged,
    /// With the gains found.
    pub after: Judged,
}

/// Report of `zenav tune wall_follow`.
#[derive(Clone, Debug, Serialize)]
pub struct TuneReport {
    /// Name of the robot.
    pub robot: String,
    /// Seed of rooms, noise and search.
    pub seed: u64,
    /// Rooms of the search.
    pub rooms: usize,
    /// Simulations of the search.
    pub simulations: usize,
    /// Simulated time of the search, s.
    pub simulated_s: f64,
    /// The gains of the robot's file.
    pub before: Gains,
    /// The gains found.
    pub after: Gains,
    /// Mean cost in the rooms of the search, before and after.
    pub cost_seen: [f64; 2],
    /// Mean cost in unseen rooms, before and after.
    pub cost_unseen: [f64; 2],
    /// Relative reduction of the cost in unseen rooms.
    pub improvement: f64,
    /// Smallest cost of each generation, in the rooms of the search.
    pub history: Vec<f64>,
    /// Unseen rooms.
    pub unseen: Vec<UnseenRoom>,
    /// Robot file with the gains found.
    pub robot_file: PathBuf,
}

/// `zenav tune`.
///
/// # Errors
/// Bad arguments, or files that cannot be written.
pub fn tune(args: &TuneArgs) -> Outcome {
    let TuneCommand::WallFollow(args) = &args.command;
    let model = files::robot(&args.robot)?;
    std::fs::create_dir_all(&args.out).map_err(Failure::failed_at(&args.out))?;
    let (report, traces) = Search::new(args, &model)?.run(args)?;
    let tuned = toml::to_string(&report.after.on(&model)).map_err(Failure::failed)?;
    let head = format!(
        "# {}, with the gains of `wall_following` found by: zenav tune wall_follow --robot {} --rooms {} --generations {} --population {} \
         --time {} --seed {}\n",
        model.name, args.robot, args.rooms, args.generations, args.population, args.time, args.seed
    );
    files::write(&report.robot_file, head + &tuned)?;
    let json = output::pretty(&report)?;
    files::write(&args.out.join("report.json"), json + "\n")?;
    files::write(&args.out.join("tuning.svg"), chart::draw(&report, &traces)?)?;
    output::value(args.output, &report, text)?;
    let better = report.improvement > 0.0 && report.unseen.iter().all(|room| room.after.collisions == 0);
    Ok(if better { exit_code::OK } else { exit_code::FAILED })
}

/// Distance errors over time in one room, m, before and after.
pub type Traces = [Vec<(f64, f64)>; 2];

/// Rooms, and the number of threads.
struct Search<'a> {
    model: &'a RobotModel,
    seen: Vec<World>,
    unseen: Vec<World>,
    secs: f64,
    seed: u64,
    threads: usize,
}

impl<'a> Search<'a> {
    fn new(args: &WallFollowArgs, model: &'a RobotModel) -> Result<Self, Failure> {
        let gap = GAP * model.wall_following.target_distance;
        let rooms = |from: u64| -> Result<Vec<World>, Failure> {
            (0..u64::from(args.rooms))
                .map(|index| room(from.wrapping_add(index), gap))
                .collect()
        };
        // Consecutive seeds would share rooms.
        let first = args.seed.wrapping_mul(1_000_003);
        Ok(Self {
            model,
            seen: rooms(first)?,
            unseen: rooms(first.wrapping_add(UNSEEN))?,
            secs: args.time,
            seed: args.seed,
            threads: args.threads.map_or_else(parallel::cores, |threads| threads as usize),
        })
    }

    /// Cost of each set of gains in each room.
    fn judge(&self, gains: &[Gains], rooms: &[World], bar: &ProgressBar) -> Result<Vec<Vec<Judged>>, Failure> {
        let done = parallel::in_order(gains.len() * rooms.len(), self.threads, |job| {
            let (gains, index) = (gains[job / rooms.len()], job % rooms.len());
            let judged = self.drive(gains, &rooms[index], index);
            bar.inc(1);
            judged
        });
        let judged: Vec<Judged> = done.into_iter().collect::<Result<_, _>>()?;
        Ok(judged.chunks(rooms.len()).map(<[_]>::to_vec).collect())
    }

    fn drive(&self, gains: Gains, room: &World, index: usize) -> Result<Judged, Failure> {
        let run = lockstep::run(
            room,
            &gains.on(self.model),
            self.seed.wrapping_add(index as u64),
            self.secs,
        )?;
        let idle = (FOLLOWING - run.following).max(0.0);
        Ok(Judged {
            cost: run.kept.rms_m + f64::from(run.truth.collisions) + idle,
            rms_m: run.kept.rms_m,
            straight_p95_m: run.kept.straight_p95_m,
            collisions: run.truth.collisions,
        })
    }

    fn run(&self, args: &WallFollowArgs) -> Result<(TuneReport, Traces), Failure> {
        let before = Gains::of(self.model);
        let (population, rooms) = (args.population as usize, self.seen.len());
        let simulations = args.generations as usize * population * rooms;
        let bar = progress(simulations + 4 * rooms);
        let mut evolution = Evolution::new(&before.logarithms(), SIGMA, population, self.seed);
        let mut history = Vec::new();
        for _ in 0..args.generations {
            let candidates = evolution.ask();
            let gains: Vec<Gains> = candidates
                .iter()
                .map(|candidate| Gains::of_logarithms(candidate))
                .collect();
            let costs: Vec<f64> = self
                .judge(&gains, &self.seen, &bar)?
                .iter()
                .map(|judged| mean(judged))
                .collect();
            history.push(costs.iter().copied().fold(f64::INFINITY, f64::min));
            evolution.tell(&candidates, &costs);
        }
        // The mean of the search is steadier than the best of noisy candidates.
        let after = Gains::of_logarithms(evolution.mean());
        let compared = |rooms: &[World]| -> Result<[Vec<Judged>; 2], Failure> {
            let mut judged = self.judge(&[before, after], rooms, &bar)?.into_iter();
            Ok(std::array::from_fn(|_| judged.next().unwrap_or_default()))
        };
        let seen = compared(&self.seen)?;
        let unseen = compared(&self.unseen)?;
        bar.finish_and_clear();
        let cost_unseen = [mean(&unseen[0]), mean(&unseen[1])];
        let report = TuneReport {
            robot: self.model.name.clone(),
            seed: self.seed,
            rooms,
            simulations,
            simulated_s: simulations as f64 * self.secs,
            before,
            after,
            cost_seen: [mean(&seen[0]), mean(&seen[1])],
            cost_unseen,
            improvement: 1.0 - cost_unseen[1] / cost_unseen[0],
            history,
            unseen: std::iter::zip(&self.unseen, std::iter::zip(&unseen[0], &unseen[1]))
                .map(|(room, (before, after))| UnseenRoom {
                    room: room.name().to_owned(),
                    before: *before,
                    after: *after,
                })
                .collect(),
            robot_file: args.out.join(format!("{}.toml", self.model.name)),
        };
        let traces = [self.trace(before)?, self.trace(after)?];
        Ok((report, traces))
    }

    /// The distance error over time in the first unseen room.
    fn trace(&self, gains: Gains) -> Result<Vec<(f64, f64)>, Failure> {
        let Some(room) = self.unseen.first() else {
            return Ok(Vec::new());
        };
        let target = self.model.wall_following.target_distance;
        let mut trace = Vec::new();
        let mut count = 0_u32;
        lockstep::watch(room, &gains.on(self.model), self.seed, self.secs, |truth, _| {
            count += 1;
            if count.is_multiple_of(10) {
                let error = super::score::distance(room, truth.map_from_base.position()) - target;
                trace.push((0.02 * f64::from(count), error));
            }
        })?;
        Ok(trace)
    }
}

fn mean(judged: &[Judged]) -> f64 {
    judged.iter().map(|judged| judged.cost).sum::<f64>() / judged.len().max(1) as f64
}

fn text(report: &TuneReport) -> String {
    let mm = |metres: f64| format!("{:.1}", 1e3 * metres);
    let rows = report.unseen.iter().map(|room| {
        [
            room.room.clone(),
            mm(room.before.rms_m),
            mm(room.after.rms_m),
            mm(room.before.straight_p95_m),
            mm(room.after.straight_p95_m),
            format!("{} {}", room.before.collisions, room.after.collisions),
        ]
    });
    let average =
        |of: fn(&UnseenRoom) -> f64| mm(report.unseen.iter().map(of).sum::<f64>() / report.unseen.len().max(1) as f64);
    let rows = rows.chain([[
        "mean".to_owned(),
        average(|room| room.before.rms_m),
        average(|room| room.after.rms_m),
        average(|room| room.before.straight_p95_m),
        average(|room| room.after.straight_p95_m),
        String::new(),
    ]]);
    let header = ["UNSEEN ROOM", "RMS mm", "TUNED", "STRAIGHT p95 mm", "TUNED", "CONTACTS"];
    let gains = |gains: &Gains| format!("p {:.2} i {:.3} d {:.2}", gains.wall_p, gains.wall_i, gains.wall_d);
    format!(
        "{}\n\ngains before: {}\ngains after:  {}\nmean cost in rooms of the search {:.4} -> {:.4}, in unseen rooms {:.4} -> {:.4}: {:.1} % less\n{} simulations, {:.1} h simulated; robot file {}",
        output::table(&header, rows),
        gains(&report.before),
        gains(&report.after),
        report.cost_seen[0],
        report.cost_seen[1],
        report.cost_unseen[0],
        report.cost_unseen[1],
        100.0 * report.improvement,
        report.simulations,
        report.simulated_s / 3600.0,
        report.robot_file.display()
    )
}
