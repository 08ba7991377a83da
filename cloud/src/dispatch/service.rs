//! Dispatch service. Asks the missions for their goals, forwards a group's goal to the chosen robot and returns that robot's answer. When
//! several processes serve a group, one accepts goals and the others are standbys.
//!
//! A resent goal goes to the robot that has it: its mission lists the goal, or this process remembers the assignment. A freshly started
//! process does not know earlier assignments, so for a while it assigns only when every mission answers.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use nalgebra::Point2;
use tokio::time::Instant;
use zenav_protocol::bus::{AskError, Bus, BusError, Latest, Shutdown};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    Annotations, GoalPhase, GoalPoint, GoalReply, GoalRequest, GoalsReply, GoalsRequest, OnBusy, PoseEstimate, Refusal,
};
use zenav_protocol::topics;

use super::{Candidate, choose, place_of};

/// Deadline for the missions to list their goals, wall time.
const ROLL_CALL: Duration = Duration::from_millis(500);
/// Deadline for the chosen mission to store the goal, wall time.
const STORED: Duration = Duration::from_secs(5);
/// For this long after its start a process assigns no goal while a mission is silent.
const SETTLING: Duration = Duration::from_secs(10);
/// A process suspended for longer than this between request and assignment assigns nothing: another process may have taken over.
const HELD_UP: Duration = Duration::from_secs(2);
/// Number of remembered assignments.
const MAX_ASSIGNED: usize = 1000;

/// What this process knows about the group.
struct Group {
    poses: BTreeMap<String, Latest<PoseEstimate>>,
    /// Places added at run time, in the map that all robots share.
    annotations: Vec<Latest<Annotations>>,
    /// Pairs of goal and robot, oldest first.
    assigned: VecDeque<(String, String)>,
    since: Instant,
}

impl Group {
    /// The robot that has a goal already: the one whose mission knows it, or the one to which this process assigned it. `known`: how often
    /// each mission that answers lists the goal.
    fn holder(&self, id: &str, known: &BTreeMap<String, usize>) -> Option<String> {
        let told = known
            .iter()
            .find(|(robot, count)| **count > 0 && self.poses.contains_key(*robot))
            .map(|(robot, _)| robot);
        let remembered = self
            .assigned
            .iter()
            .find(|(goal, _)| goal == id)
            .map(|(_, robot)| robot);
        told.or(remembered).cloned()
    }

    /// The robot that suits a new goal best. `open`: the number of open goals of each mission that answers.
    fn chosen(
        &mut self,
        open: &BTreeMap<String, usize>,
        at: Option<Point2<f64>>,
        on_busy: OnBusy,
    ) -> Result<String, Refusal> {
        let silent = self.poses.keys().find(|robot| !open.contains_key(*robot));
        if let Some(silent) = silent.filter(|_| self.since.elapsed() < SETTLING) {
            return Err(Refusal::Busy {
                reason: format!("{silent} does not answer and may have the goal already"),
            });
        }
        let candidate = |(robot, pose): (&String, &mut Latest<PoseEstimate>)| {
            Some(Candidate {
                robot: robot.clone(),
                position: pose.borrow().map(|pose| pose.map_from_base.position()),
                outstanding: *open.get(robot)?,
            })
        };
        let candidates: Vec<Candidate> = self.poses.iter_mut().filter_map(candidate).collect();
        Ok(choose(&candidates, at, on_busy)?.robot.clone())
    }

    /// Keeps an assignment, and the others as far as there is room.
    fn remember(&mut self, id: String, robot: String) {
        self.assigned.retain(|(goal, _)| *goal != id);
        if self.assigned.len() == MAX_ASSIGNED {
            self.assigned.pop_front();
        }
        self.assigned.push_back((id, robot));
    }
}

/// Accepts goals for a group of robots until shutdown.
///
/// # Errors
/// [`BusError`] if the group's key cannot be served.
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
        annotations: Vec::new(),
        assigned: VecDeque::new(),
        since: Instant::now(),
    };
    for robot in &robots {
        known
            .poses
            .insert(robot.to_string(), bus.latest(&topics::POSE, &[robot.as_str()])?);
        known
            .annotations
            .push(bus.latest(&topics::ANNOTATIONS, &[robot.as_str()])?);
    }
    // Of several orchestrators of this group, the first by name accepts goals; otherwise a goal could go to two robots.
    let service = format!("group-{group}");
    let place = |worker: &str| topics::alive_key(topics::ALIVE_WORKER, &[&service, worker]);
    let own = place(&bus.zid());
    let _alive = bus.declare_alive(own.clone())?;
    bus.serve_info("dispatch", group.as_str(), BTreeMap::new())?;
    bus.started();
    tracing::info!(%group, robots = robots.len(), "accepts goals for a group");
    let mut was_first = true;
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
            was_first = false;
            request.refuse(&Refusal::NotLeader);
            continue;
        }
        if !std::mem::replace(&mut was_first, true) {
            // The previous leader's assignments are known only to the robots, and a silent robot may have one.
            known.since = Instant::now();
        }
        let added = known
            .annotations
            .iter_mut()
            .filter_map(Latest::borrow)
            .find_map(|annotations| place_of(&request.body, &annotations.places));
        let at = added.or_else(|| place_of(&request.body, &places));
        match assign(&bus, &mut known, &request.body, at).await {
            Ok(reply) => request.reply(&reply),
            Err(refusal) => request.refuse(&refusal),
        }
    }
}

/// Assigns a goal to a robot of the group.
async fn assign(
    bus: &Bus,
    group: &mut Group,
    request: &GoalRequest,
    at: Option<Point2<f64>>,
) -> Result<GoalReply, Refusal> {
    let Some(id) = request.id.clone() else {
        let reason = "`id`: required, so that a goal sent again is the same goal";
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
    let robot = match group.holder(&id, &known) {
        Some(robot) => robot,
        None => group.chosen(&open, at, request.on_busy)?,
    };
    if begun.elapsed() > HELD_UP {
        return Err(Refusal::NotLeader);
    }
    group.remember(id, robot.clone());
    match bus.ask(&topics::GOAL, &[&robot], request, STORED).await {
        Ok(reply) => Ok(GoalReply {
            robot: Some(robot),
            ..reply
        }),
        // A standby may answer in place of a leader that has stored the goal; a busy mission may have it from an earlier attempt.
        Err(AskError::Refused(refusal)) if !matches!(refusal, Refusal::NotLeader | Refusal::Busy { .. }) => {
            // The goal was not accepted: another robot may get it.
            group.assigned.pop_back();
            Err(refusal)
        }
        Err(error) => Err(Refusal::Busy {
            reason: format!("{robot}: {error}"),
        }),
    }
}

/// Number of matching goals of each robot that answers.
async fn goals(bus: &Bus, request: GoalsRequest) -> BTreeMap<String, usize> {
    let answers = bus.ask_all(&topics::GOALS, &["*"], &request, ROLL_CALL).await;
    let counted = answers.unwrap_or_default().into_iter().filter_map(|answer| {
        let reply: GoalsReply = answer.result.ok()?;
        Some((answer.chunks.first()?.clone(), reply.goals.len()))
    });
    counted.collect()
}
