//! `zenav demo wall_follow`. A Neato with 360 beams and a bumper follows the walls of a room with inner and outer corners for ten minutes,
//! without a cloud and without a goal.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use nalgebra::Point2;
use zenav_edge::Referee;
use zenav_protocol::bus::{Bus, BusConfig, Latest, Subscription};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{EdgeState, Event, EventKind, Mode, WallFollowerState};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;
use zenav_sim::World;

use super::script::Script;
use super::{DemoArgs, Stage, live_display};
use crate::batch::backdrop;
use crate::components::Parts;
use crate::drawing::canvas::Color;
use crate::drawing::plane::Mark;
use crate::failure::Failure;
use crate::files;
use crate::gateway;
use crate::report::{DemoReport, WallReport};
use crate::wall_following::score::Errors;

/// Simulated time between two samples of the distance, s.
const SAMPLE: f64 = 0.1;
/// Period of progress lines in a plain log, wall time.
const LOG_EVERY: Duration = Duration::from_secs(5);
/// Largest allowed 95th percentile of the distance error on straight walls, m.
const ALLOWED: f64 = 0.03;
/// Smallest share of the time that the robot must spend along walls.
const FOLLOWING: f64 = 0.5;
/// Pixels of the picture's longer side, and the colour of the path.
const PICTURE: u32 = 1000;
const DRIVEN: Color = [215, 60, 40];
/// Time for the robot to start, and for the last events to arrive, wall time.
const PATIENCE: Duration = Duration::from_secs(20);
const LAST_EVENTS: Duration = Duration::from_millis(500);
/// Period of requesting the robot's retained events while the first ones are missing, wall time.
const ASK_AGAIN: Duration = Duration::from_secs(3);

/// Observations of the run.
struct Watch<'a> {
    world: &'a World,
    target: f64,
    referee: Referee,
    states: Latest<EdgeState>,
    events: Subscription<Event>,
    /// The robot's retained events, requested again while the first ones are missing: on a busy machine they may be published before the
    /// link is up.
    kept: Option<Subscription<Event>>,
    bus: Bus,
    robot: Id,
    state: Option<EdgeState>,
    log: BTreeMap<u64, Event>,
    errors: Errors,
    sampled: Stamp,
    following: f64,
    /// Driven path, map frame.
    driven: Vec<Point2<f64>>,
    /// End of the evaluated time.
    end: Stamp,
}

/// Runs the scenario to its end.
///
/// # Errors
/// A part that failed, or Ctrl-C.
pub(super) async fn play(stage: &Stage<'_>, parts: &mut Parts) -> Result<DemoReport, Failure> {
    let Stage {
        args,
        script,
        deployment,
        world,
        stop,
        ..
    } = *stage;
    let (id, section) = stage.robot()?;
    let bus = Bus::open(BusConfig::command("demo", stage.endpoint)).await?;
    let robot = &[id.as_str()];
    let mut watch = Watch {
        world,
        target: files::robot(&section.model)?.wall_following.target_distance,
        events: bus.subscribe(&topics::EVENT, robot, 1024)?,
        states: bus.latest(&topics::STATE, robot)?,
        referee: parts.edge(deployment, world)?,
        kept: None,
        bus: bus.clone(),
        robot: id.clone(),
        state: None,
        log: BTreeMap::new(),
        errors: Errors::default(),
        sampled: Stamp::ZERO,
        following: 0.0,
        driven: Vec::new(),
        end: Stamp::from_secs(script.time_limit),
    };
    if let Some(page) = parts.gateway(deployment, world).await? {
        gateway::tell(&page);
    }
    tokio::select! {
        ended = parts.first_end() => { ended?; return Err(Failure::failed("the parts ended")); }
        () = stop.wait() => return Err(Failure::interrupted()),
        result = watch.until_end(args) => result?,
    }
    bus.close().await;
    write_log(args, &watch.log)?;
    draw(args, world, &watch.driven)?;
    let mut report = watch.report(&script, args);
    report.files = ["events.ndjson", "path.png"]
        .map(|name| args.folder().join(name))
        .into();
    Ok(report)
}

/// Writes the event log, one event per line.
fn write_log(args: &DemoArgs, log: &BTreeMap<u64, Event>) -> Result<(), Failure> {
    let lines: Result<Vec<String>, _> = log.values().map(serde_json::to_string).collect();
    let lines = lines.map_err(Failure::failed)?.into_iter().map(|line| line + "\n");
    files::write(&args.folder().join("events.ndjson"), lines.collect::<String>())
}

/// Draws the room and the driven path.
fn draw(args: &DemoArgs, world: &World, driven: &[Point2<f64>]) -> Result<(), Failure> {
    let mut plane = backdrop(world, PICTURE)?;
    plane.polyline(driven, DRIVEN, 2.0);
    plane.legend(Mark::Line, DRIVEN, "driven");
    files::write(&args.folder().join("path.png"), plane.finish()?.png()?)
}

/// The next retained event; waits for ever if none were requested.
async fn kept(kept: &mut Option<Subscription<Event>>) -> Option<Event> {
    match kept {
        Some(kept) => kept.next().await.map(|event| event.message),
        None => std::future::pending().await,
    }
}

impl Watch<'_> {
    async fn until_end(&mut self, args: &DemoArgs) -> Result<(), Failure> {
        let period = Duration::from_secs_f64((SAMPLE / args.speed).clamp(1e-3, SAMPLE));
        let mut pace = tokio::time::interval(period);
        pace.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        let bar = live_display(args);
        let began = Instant::now();
        let mut told = began;
        let mut asked = began;
        while self.referee.now() < self.end {
            tokio::select! {
                biased;
                event = self.events.next() => self.note(event.map(|event| event.message)),
                event = kept(&mut self.kept) => self.note(event),
                _ = self.states.changed() => self.state = self.states.take().or(self.state.take()),
                _ = pace.tick() => {
                    self.sample();
                    if self.lacks_first() {
                        if asked.elapsed() > ASK_AGAIN {
                            asked = Instant::now();
                            self.kept = Some(self.bus.subscribe(&topics::EVENT, &[self.robot.as_str()], 1024)?);
                        }
                    } else {
                        self.kept = None;
                    }
                    let line = self.line();
                    if let Some(bar) = &bar {
                        bar.set_message(line);
                    } else if told.elapsed() > LOG_EVERY {
                        tracing::info!("{line}");
                        told = Instant::now();
                    }
                    if self.state.is_none() && began.elapsed() > PATIENCE {
                        return Err(Failure::timeout("the robot does not tell its state"));
                    }
                }
            }
        }
        // The last events may still be on their way.
        let end = tokio::time::sleep(LAST_EVENTS);
        tokio::pin!(end);
        loop {
            tokio::select! {
                event = self.events.next() => self.note(event.map(|event| event.message)),
                () = &mut end => break,
            }
        }
        if let Some(bar) = bar {
            bar.finish_and_clear();
        }
        Ok(())
    }

    /// Whether there are events, but not the first one.
    fn lacks_first(&self) -> bool {
        self.log.keys().next().is_some_and(|first| *first > 1)
    }

    fn note(&mut self, event: Option<Event>) {
        if let Some(event) = event.filter(|event| event.stamp <= self.end) {
            self.log.insert(event.sequence, event);
        }
    }

    fn sample(&mut self) {
        let now = self.referee.now();
        let since = now.secs_since(self.sampled);
        if since < SAMPLE {
            return;
        }
        self.sampled = now;
        let at = self.referee.truth().map_from_base.position();
        self.driven.push(at);
        let follows = self.state.as_ref().is_some_and(|state| {
            state.mode == Mode::WallFollow && state.wall_follower == Some(WallFollowerState::WallFollow)
        });
        if follows {
            self.following += since;
            self.errors.sample(self.world, at, self.target);
        }
    }

    fn line(&self) -> String {
        let state = self.state.as_ref();
        format!(
            "t {:5.1} of {:.0} s  {:11}  {:.2} m/s  {:.1} m driven",
            self.referee.now().as_secs(),
            self.end.as_secs(),
            state
                .and_then(|state| state.wall_follower)
                .map_or("starting", WallFollowerState::name),
            state.map_or(0.0, |state| state.velocity.v),
            self.referee.truth().length,
        )
    }

    /// The follower's transitions with their counts, and whether they are complete: each starts where the previous one ended, and no event
    /// of the boot is missing.
    fn transitions(&self) -> (BTreeMap<String, u64>, bool) {
        let mut counts = BTreeMap::new();
        let mut at = WallFollowerState::default().name();
        let mut told = at;
        let mut complete = self.log.keys().copied().eq(1..=self.log.len() as u64);
        for event in self.log.values() {
            if let EventKind::Transition { from, to, .. } = &event.kind {
                complete &= from == at;
                at = to;
                if self.state.as_ref().is_some_and(|state| event.stamp <= state.stamp) {
                    told = to;
                }
                *counts.entry(format!("{from} -> {to}")).or_default() += 1;
            }
        }
        let ends = self.state.as_ref().and_then(|state| state.wall_follower);
        (counts, complete && ends.is_none_or(|state| state.name() == told))
    }

    fn report(&self, script: &Script, args: &DemoArgs) -> DemoReport {
        let truth = self.referee.truth();
        let sim_time = self.end.as_secs();
        let kept = self.errors.kept();
        let (transitions, complete) = self.transitions();
        let bumps = self
            .log
            .values()
            .filter(|event| event.kind == EventKind::Bumped)
            .count() as u64;
        let following = self.following / sim_time.max(1e-9);
        let reason = if truth.collisions > 0 || bumps > 0 {
            Some("the robot touched something".to_owned())
        } else if following < FOLLOWING || kept.straight_samples == 0 {
            Some(format!(
                "walls were followed for {:.0} % of the time only",
                100.0 * following
            ))
        } else if kept.straight_p95_m >= ALLOWED {
            Some(format!("the distance error is over {ALLOWED} m"))
        } else if !complete {
            Some("the event log has a gap".to_owned())
        } else {
            None
        };
        DemoReport {
            walls: Some(WallReport {
                target_m: self.target,
                kept,
                bumps,
                driven_m: truth.length,
                following,
                transitions,
                complete,
                missed_ticks: self.state.as_ref().map_or(0, |state| state.missed_ticks),
            }),
            ..DemoReport::new(script.name, args.seed, args.speed, &truth, sim_time, reason)
        }
    }
}
