//! `zenav demo`. Runs one scenario on this machine over real Zenoh sessions, to its end, with a report.
//!
//! The parts connect to a router on a free loopback port; the demo itself is another client, which submits the mission as one goal and
//! watches. Clearance, contacts and errors come from the simulator's ground truth, which no part sees.
//!
//! | file | answers |
//! |---|---|
//! | `script` | the scenarios |
//! | `wall_follow` | how does a robot follow walls on its own, without a cloud? |
//! | `watch` | how did the run go, from a client's and from the referee's view? |
//! | `refusals` | are unreachable goals refused, and with which reasons? |
//! | `recorded` | the bus traffic, as a page, a film and a file |
//! | `album` | what did the robot know, plan and drive? pictures |

mod album;
mod recorded;
mod refusals;
mod script;
mod wall_follow;
mod watch;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use indicatif::ProgressBar;
use zenav_cloud::mapping::PoseSource;
use zenav_mapping::write_map;
use zenav_planning::Planner;
use zenav_protocol::bus::{Bus, BusConfig, Router, RouterConfig, Security, Shutdown};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{DrivingProfile, GoalRequest, LostPolicy};
use zenav_protocol::topics;
use zenav_sim::World;

use crate::arguments;
use crate::completion;
use crate::components::{CloudPart, Parts};
use crate::config::{self, Deployment, RobotSection};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::gateway::{self, PageArgs};
use crate::health::HealthArgs;
use crate::launch::{KnownMapArgs, PoseArgs, runtime};
use crate::live_map::LiveMap;
use crate::lockstep::true_map;
use crate::output::{Format, pretty, spinner, value};
use crate::report::{DemoReport, ScenarioOutcome};
use crate::tasks;
use album::Album;
use recorded::{Played, Recorder};
use script::{Scenario, Script};
use watch::Watch;

/// Time for the parts to start, wall time.
const START_UP: Duration = Duration::from_secs(20);

/// What a scenario is played with.
struct Stage<'a> {
    args: &'a DemoArgs,
    script: Script,
    deployment: &'a Deployment,
    world: &'a World,
    /// The router's endpoint.
    endpoint: &'a str,
    /// Set by Ctrl-C.
    stop: &'a Shutdown,
}

impl Stage<'_> {
    /// The deployment's robot.
    fn robot(&self) -> Result<(Id, &RobotSection), Failure> {
        let robots = self.deployment.robot_ids()?;
        let robot = robots.into_iter().next();
        robot.ok_or_else(|| Failure::failed("the deployment has no robot"))
    }
}

/// Arguments of `zenav demo`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav demo kitchen                    a first mission, in a map that is made on the way\n  zenav demo online --speed 4\n  zenav demo kitchen --record run.mcap  for replay, diff, film and Foxglove"
)]
pub struct DemoArgs {
    /// Scenario to run
    #[arg(value_enum, default_value = "kitchen")]
    scenario: Scenario,
    /// Simulated time relative to wall time
    #[arg(long, default_value_t = 1.0, value_parser = arguments::speed)]
    speed: f64,
    /// Seed of all noise
    #[arg(long, default_value_t = 1, value_parser = arguments::whole::<u64>)]
    seed: u64,
    /// Give the robot GPS and a compass, and map with its own poses (kitchen and online)
    #[arg(long)]
    gps: bool,
    /// Planner, instead of the scenario's
    #[arg(long, add = completion::planners())]
    planner: Option<Planner>,
    /// Driving profile, `fastest` or `economy`
    #[arg(long)]
    profile: Option<DrivingProfile>,
    /// Folder for `report.json`, `report.html`, `map.pgm`, `map.yaml` and pictures; the kitchen scenario uses a map that is already there
    /// [default: zenav-out/SCENARIO]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write an animation of the run (all but wall_follow)
    #[arg(long, value_name = "FILE.gif")]
    film: Option<PathBuf>,
    /// Keep the record of the run in this file; it must not exist yet
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Print plain log lines instead of a live display
    #[arg(long)]
    no_ui: bool,
    #[command(flatten)]
    known: KnownMapArgs,
    #[command(flatten)]
    begin: PoseArgs,
    #[command(flatten)]
    page: PageArgs,
    #[command(flatten)]
    health: HealthArgs,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

impl DemoArgs {
    /// Output folder.
    fn folder(&self) -> PathBuf {
        let own = || Path::new("zenav-out").join(self.scenario.script().name);
        self.out.clone().unwrap_or_else(own)
    }
}

/// `zenav demo`.
///
/// # Errors
/// Bad arguments, or a part that failed.
pub fn run(args: &DemoArgs) -> Outcome {
    if let Some(film) = &args.film {
        let ending = film.extension().and_then(|ending| ending.to_str());
        if !ending.is_some_and(|ending| ending.eq_ignore_ascii_case("gif")) || args.scenario.script().alone {
            return Err(Failure::usage(format!(
                "--film {}: expected a name that ends with .gif, and another run than wall_follow",
                film.display()
            )));
        }
    }
    if args.known.names_map() && args.scenario.script().alone {
        return Err(Failure::usage(
            "--map: wall_follow drives without a map; expected kitchen or online",
        ));
    }
    if args.gps && !args.scenario.has_gps() {
        return Err(Failure::usage("--gps: expected kitchen or online"));
    }
    let folder = args.folder();
    std::fs::create_dir_all(&folder).map_err(Failure::failed_at(&folder))?;
    args.film.as_deref().map_or(Ok(()), files::writable)?;
    let Played { mut report, kept } = tasks::block_on(&runtime()?, scenario(args))?;
    let file = folder.join("report.json");
    report.files.insert(0, file.clone());
    let text = pretty(&report)?;
    let written = files::write(&file, text + "\n");
    value(args.output, &report, DemoReport::text)?;
    // The report is printed even if a file could not be written.
    written.and(kept)?;
    Ok(if report.outcome == ScenarioOutcome::Succeeded {
        exit_code::OK
    } else {
        exit_code::FAILED
    })
}

/// The shipped deployment on free ports, with the script's robot and its files in a folder of this run.
fn deployment(args: &DemoArgs, script: &Script, endpoint: &str, state: &Path) -> Result<Deployment, Failure> {
    let mut deployment = config::load(None)?;
    deployment.bus.connect = endpoint.to_owned();
    deployment.simulation = config::SimulationSection {
        world: script.world.to_owned(),
        seed: args.seed,
        speed: args.speed,
    };
    deployment.data.dir = state.to_path_buf();
    deployment.mapping.run.poses = script.poses;
    let (id, model) = script.robot;
    let robot = RobotSection {
        model: match script.poses {
            PoseSource::Edge => model.to_owned(),
            PoseSource::Slam | PoseSource::Localise => format!("{model}+indoor"),
        },
        on_lost: if script.alone {
            LostPolicy::WallFollow
        } else {
            LostPolicy::default()
        },
        ..RobotSection::default()
    };
    deployment.robots = [(id.to_owned(), robot)].into();
    // Several demos may run on one machine at once.
    if !args.page.names_address() {
        gateway::FREE_PORT.clone_into(&mut deployment.gateway.settings.listen);
    }
    args.known.apply(&mut deployment);
    args.begin.apply(&mut deployment)?;
    args.page.apply(&mut deployment);
    if let Some(planner) = args.planner.map(Planner::name).or(script.planner) {
        planner.clone_into(&mut deployment.planning.run.planner);
    }
    Ok(deployment)
}

/// Files of a stored map.
const MAP_FILES: [&str; 3] = ["map.pgm", "map.yaml", "map.json"];

/// Copies a stored map; returns the files found.
fn copy_map(from: &Path, to: &Path) -> Result<Vec<PathBuf>, Failure> {
    std::fs::create_dir_all(to).map_err(Failure::failed_at(to))?;
    let mut copied = Vec::new();
    for name in MAP_FILES {
        let (source, target) = (from.join(name), to.join(name));
        if source.is_file() {
            std::fs::copy(&source, &target).map_err(Failure::failed_at(&target))?;
            copied.push(target);
        }
    }
    Ok(copied)
}

async fn scenario(args: &DemoArgs) -> Result<Played, Failure> {
    let began = Instant::now();
    // From here on, so that the files of this run are removed whenever Ctrl-C comes.
    let stop = Shutdown::on_interrupt();
    let mut script = args.scenario.script();
    // Goals and epochs belong to this run; only the map outlives it.
    let folder = args.folder();
    let state = folder.join(format!(".run-{}", std::process::id()));
    let robot_dir = state.join(script.robot.0);
    let map_found = script.uses_stored_map && !copy_map(&folder, &robot_dir)?.is_empty();
    let is_mapped = map_found || args.known.names_map();
    script.poses = match script.poses {
        _ if args.gps => PoseSource::Edge,
        PoseSource::Slam if is_mapped => PoseSource::Localise,
        poses => poses,
    };
    let result = async {
        args.health.serve(&Security::Loopback).await?;
        let router = Router::open(&RouterConfig {
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            ..RouterConfig::default()
        })
        .await?;
        let endpoint = router
            .endpoints()
            .await
            .into_iter()
            .next()
            .ok_or_else(|| Failure::failed("the router has no endpoint"))?;
        let deployment = deployment(args, &script, &endpoint, &state)?;
        let world = files::world(&deployment.simulation.world)?;
        let mut deployment = deployment;
        if script.poses == PoseSource::Localise && !is_mapped {
            let map = true_map(&world, deployment.mapping.settings.resolution)?;
            let file = write_map(&state, "known", &map, "the true map").map_err(Failure::failed)?;
            deployment.mapping.run.map = Some(file);
        }
        let mut parts = Parts::default();
        // Started before the parts, so that their first messages are recorded.
        let recorder = Recorder::begin(args, &script, &endpoint, &state).await?;
        let stage = Stage {
            args,
            script,
            deployment: &deployment,
            world: &world,
            endpoint: &endpoint,
            stop: &stop,
        };
        let played = if script.alone {
            wall_follow::play(&stage, &mut parts).await
        } else {
            play(&stage, &mut parts).await
        };
        // Without the rendering of page and film.
        let played = played.map(|report| DemoReport {
            wall_time_s: began.elapsed().as_secs_f64(),
            ..report
        });
        parts.end().await;
        let played = recorder.end(played, &stop).await;
        router.close().await;
        played
    }
    .await;
    let copied = copy_map(&robot_dir, &folder);
    let _ = std::fs::remove_dir_all(&state);
    let mut played = result?;
    let report = &mut played.report;
    match copied {
        Ok(files) => report.files.extend(files),
        Err(failure) => played.kept = played.kept.and(Err(failure)),
    }
    report.map_found = map_found;
    Ok(played)
}

async fn play(stage: &Stage<'_>, parts: &mut Parts) -> Result<DemoReport, Failure> {
    let Stage {
        args,
        script,
        deployment,
        world,
        stop,
        ..
    } = *stage;
    let (id, _) = stage.robot()?;
    let referee = parts.edge(deployment, world)?;
    parts.cloud(deployment, world, CloudPart::All, "demo")?;
    let page = parts.gateway(deployment, world).await?;
    let bus = Bus::open(BusConfig::command("demo", stage.endpoint)).await?;
    let mut watch = Watch::new(&bus, &id, referee, world)?;
    watch.carried = script.carried.map(|carried| (carried, world.clone()));
    if script.drawn {
        watch.album = Some(Album::new(&bus, &id, &args.folder(), album::places(world))?);
    }
    let request = GoalRequest {
        id: Some(format!("{}-{}", script.name, args.seed)),
        tree: Some(script.tree.to_owned()),
        profile: args.profile,
        ..GoalRequest::default()
    };
    watch.narrate("waiting for the parts");
    let robot = [id.as_str()];
    let reply = tokio::select! {
        reply = bus.ask(&topics::GOAL, &robot, &request, START_UP) => reply?,
        ended = parts.first_end() => { ended?; return Err(Failure::failed("the parts ended")); }
        () = stop.wait() => return Err(Failure::interrupted()),
    };
    if let Some(page) = &page {
        gateway::tell(page);
    }
    watch.bar = live_display(args);
    let drawing = match &watch.bar {
        Some(bar) => Some(LiveMap::new(&bus, id.as_str())?.above(bar)),
        None => None,
    };
    watch.narrate(&format!("goal {} accepted", reply.id));
    let asking = tokio::spawn(refusals::ask(
        bus.clone(),
        id.clone(),
        reply.id.clone(),
        script.impossible,
    ));
    let end = tokio::select! {
        end = watch.until_end(&reply.id, script.time_limit) => end,
        ended = parts.first_end() => { ended?; None }
        () = stop.wait() => {
            drop(drawing);
            if let Some(bar) = &watch.bar {
                bar.finish_and_clear();
            }
            return Err(Failure::interrupted());
        }
    };
    drop(drawing);
    if let Some(bar) = &watch.bar {
        bar.finish_and_clear();
    }
    let files = match watch.album.take() {
        Some(album) => album.finish().await?,
        None => Vec::new(),
    };
    let refusals = if end.is_some() { Some(asking.await) } else { None };
    bus.close().await;
    let mut report = watch.report(&script, args, end);
    report.files = files;
    match refusals {
        Some(Ok(Ok(refused))) => report.refused = refused,
        Some(Ok(Err(why))) => report.fail(why),
        Some(Err(error)) => report.fail(error.to_string()),
        None => {}
    }
    Ok(report)
}

/// A live display, if wanted and possible.
fn live_display(args: &DemoArgs) -> Option<ProgressBar> {
    if args.no_ui { None } else { spinner() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_film_that_cannot_be_written_is_refused_before_the_demonstration() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let film = folder.path().join("none/run.gif").display().to_string();
        let words = ["kitchen", "--film", &film, "--out", out.to_str().unwrap()];
        let refused = run(&crate::cli::parsed(&words).unwrap()).unwrap_err();
        assert!(refused.message.contains("run.gif"), "{refused}");
        assert_eq!(std::fs::read_dir(&out).unwrap().count(), 0, "nothing was begun");
    }
}
