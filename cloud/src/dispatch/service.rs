//! How does a group's goal reach its robot? The missions tell their goals, the chosen one stores it; its answer is the group's.
//! Where several processes serve a group, one of them takes the goals and the others stand by.
//!
//! A goal that is sent again goes to the robot that it was given to: the missions tell, or it is remembered. Until a process has been there for
//! a while it does not know what was given before, so all missions must tell then.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use nalgebra::Point2;
use tokio::time::Instant;
use zenav_protocol::bus::{AskError, Bus, BusError, Latest, Shutdown};
use zenav_protocol::id::Id;
use zenav_protocol::messages::*;
use zenav_protocol::topics;

use super::{Candidate, choose, place_of};

/// Wall time for the robots to tell their goals.
const ROLL_CALL: Duration = Duration::from_millis(500);
/// Wall time for the chosen robot's mission to store the goal.
const STORED: Duration = Duration::from_secs(5);
/// For so long after its start a process gives no goal while a mission is silent.
const NEW: Duration = Duration::from_secs(10);
/// A process that was held up for longer between a request and its answer gives nothing: another may have.
const HELD_UP: Duration = Duration::from_secs(2);
/// Gifts that are remembered.
const MAX_GIVEN: usize = 1000;

/// What a process knows of the group.
struct Group {
    poses: BTreeMap<String, Latest<PoseEstimate>>,
    /// Which robot a goal was given to, in the order of giving.
    given: VecDeque<(String, String)>,
    since: Instant,
}

/// Takes goals for a group of robots until the shutdown.
///
/// # Errors
/// [`BusError`] when the group's key cannot be served.
pub async fn run(
    bus: Bus,
    group: Id,
    robots: Vec<Id>,
    places: BTreeMap<String, GoalPoint>,
    shutdown: Shutdown,
) -> Result<(), BusError> {
    let mut server = bus.serve(&topics::GOAL, &[group.as_str()])?;
    let mut known = Group {
        poses: BTreeMap::new(),
        given: VecDeque::new(),
        since: Instant::now(),
    };
    for robot in &robots {
        known
            .poses
            .insert(robot.to_string(), bus.latest(&topics::POSE, &[robot.as_str()])?);
    }
    // Of several orchestrators with this group the first by name takes its goals, so that no goal goes to two robots.
    let service = format!("group-{group}");
    let place = |worker: &str| topics::alive_key(topics::ALIVE_WORKER, &[&service, worker]);
    let own = place(&bus.zid());
    let _alive = bus.declare_alive(own.clone())?;
    tracing::info!(%group, robots = robots.len(), "takes goals for a group");
    loop {
        let request = tokio::select! {
            () = shutdown.wait() => return Ok(()),
            request = server.next() => match request {
                Some(request) => request,
                None => return Ok(()),
            },
        };
        let first = bus.list_alive(place("*"), ROLL_CALL).await?.into_iter().next();
        if first.is_some_and(|first| first != own) {
            request.refuse(&Refusal::NotLeader);
            continue;
        }
        match give(&bus, &mut known, &request.body, place_of(&request.body, &places)).await {
            Ok(reply) => request.reply(&reply),
            Err(refusal) => request.refuse(&refusal),
        }
    }
}

/// Gives a goal to a robot of the group.
async fn give(
    bus: &Bus,
    group: &mut Group,
    request: &GoalRequest,
    at: Option<Point2<f64>>,
) -> Result<GoalReply, Refusal> {
    let Some(id) = request.id.clone() else {
        let reason = "id: expected one, for a goal that is sent again is the same goal";
        return Err(Refusal::bad_request(reason.to_owned()));
    };
    let begun = Instant::now();
    let open = vec![GoalPhase::Accepted, GoalPhase::Active, GoalPhase::Paused];
    let (known, open) = tokio::join!(
        goals(
            bus,
            GoalsRequest {
                id: Some(id.clone()),
                ..GoalsRequest::default()
            }
        ),
        goals(
            bus,
            GoalsRequest {
                states: open,
                ..GoalsRequest::default()
            }
        )
    );
    let told = known
        .iter()
        .find(|(robot, count)| **count > 0 && group.poses.contains_key(*robot))
        .map(|(robot, _)| robot);
    let remembered = group.given.iter().find(|(goal, _)| *goal == id).map(|(_, robot)| robot);
    let robot = match told.or(remembered) {
        Some(robot) => robot.clone(),
        None => {
            let silent = group.poses.keys().find(|robot| !open.contains_key(*robot));
            if let Some(silent) = silent.filter(|_| group.since.elapsed() < NEW) {
                return Err(Refusal::Busy {
                    reason: format!("{silent} may have the goal already, and does not answer"),
                });
            }
            let candidates: Vec<Candidate> = group
                .poses
                .iter_mut()
                .filter_map(|(robot, pose)| {
                    Some(Candidate {
                        robot: robot.clone(),
                        position: pose.borrow().map(|pose| pose.map_from_base.position()),
                        outstanding: *open.get(robot)?,
                    })
                })
                .collect();
            choose(&candidates, at, request.on_busy)?.robot.clone()
        }
    };
    if begun.elapsed() > HELD_UP {
        return Err(Refusal::NotLeader);
    }
    if group.given.len() == MAX_GIVEN {
        group.given.pop_front();
    }
    group.given.push_back((id, robot.clone()));
    match bus.ask(&topics::GOAL, &[&robot], request, STORED).await {
        Ok(reply) => Ok(GoalReply {
            robot: Some(robot),
            ..reply
        }),
        Err(AskError::Refused(refusal)) => {
            // It has not been taken: another robot may.
            group.given.pop_back();
            Err(refusal)
        }
        Err(error) => Err(Refusal::Busy {
            reason: format!("{robot}: {error}"),
        }),
    }
}

/// How many such goals each robot has that answers.
async fn goals(bus: &Bus, request: GoalsRequest) -> BTreeMap<String, usize> {
    let answers = bus.ask_all(&topics::GOALS, &["*"], &request, ROLL_CALL).await;
    let counted = answers.unwrap_or_default().into_iter().filter_map(|answer| {
        let reply: GoalsReply = answer.result.ok()?;
        Some((answer.chunks.first()?.clone(), reply.goals.len()))
    });
    counted.collect()
}
