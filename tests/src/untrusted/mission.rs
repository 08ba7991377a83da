//! A mission's inputs. Lines of a message's name and its JSON, each for one step of a mission: what clients ask of it, what the robot and
//! mapping publish, and what they and the workers answer.

#![allow(
    clippy::expect_used,
    reason = "a record that was stored and cannot be read is a finding"
)]

use serde::Serialize;
use serde::de::DeserializeOwned;
use zenav_mission::{Answer, Ask, Client, Effect, Inputs, Mission, MissionConfig, NoAnswer, Record, Restored, Ticket};
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::id::Id;
use zenav_protocol::messages::TILE;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{MissionReply, MissionRequest};

use super::wire::golden;

/// Most steps of one input.
const MOST_STEPS: usize = 200;
/// Time of the first step, and between two, s.
const START: f64 = 100.0;
const PERIOD: f64 = 0.05;
/// Steps after the restart.
const STEPS_AFTER: u8 = 4;
/// A drive: the robot shows and is leased, its room is mapped, and everybody answers until it is told to move.
const DRIVE: &str = r#"EdgeState {"stamp":1500000000,"boot_id":"b1","mode":"idle","link":"Connected","lease":{"holder":"mission-a","role":"mission","epoch":5,"live":true},"plan":null,"velocity":{"v":0,"w":0},"guard":"clear","battery":0.5,"behaviour":null}
PoseEstimate {"stamp":1500000000,"map_from_base":{"x":0,"y":0,"yaw":0},"covariance":[0.01,0,0,0,0.01,0,0,0,0.02],"velocity":{"v":0,"w":0}}
ROBOT
LeaseReply {"epoch":5,"ttl_secs":1.0,"boot_id":"b1"}
MapInfo {"stamp":1500000000,"map":{"id":"kitchen","revision":12},"spec":{"origin":[-1.6,-1.6],"resolution":0.05,"width":64,"height":64},"free":4096,"occupied":0,"unknown":0,"scans":40,"stored":true}
MapPatch {"stamp":1500000000,"map":{"id":"kitchen","revision":12},"base_revision":0,"spec":{"origin":[-1.6,-1.6],"resolution":0.05,"width":64,"height":64},"tiles":[{"x":0,"y":0,"values":[CELLS]}]}
GoalRequest {"id":"g1","x":0.9,"y":0.0}
MotionReply {"kind":"trajectory","plan":{"map":{"id":"kitchen","revision":12},"outcome":{"outcome":"Found","path":[[0,0],[0.9,0]],"length":0.9},"leg":0,"escapes":false,"search_ms":1.5,"expansions":10},"smooth":{"map":{"id":"kitchen","revision":12},"trajectory":[{"t":0,"x":0,"y":0,"yaw":0,"v":0,"w":0},{"t":3,"x":0.45,"y":0,"yaw":0,"v":0.3,"w":0},{"t":6,"x":0.9,"y":0,"yaw":0,"v":0,"w":0}],"statistics":{"planner":"astar","search_ms":1.5,"corridor_ms":0.5,"geometry_ms":2.0,"timing_ms":0.25,"length":0.9,"duration":6.0,"energy_j":8.0,"min_clearance":0.3,"status":"smoothed","solver":"Solved"}}}
"#;
/// A goal whose tree takes a while.
const GOAL: &str = r#"GoalRequest {"id":"rest","tree":"<root BTCPP_format='4'><BehaviorTree ID='Main'><Sequence><Sleep msec='90'/><Sleep msec='900'/></Sequence></BehaviorTree></root>"}
InfoRequest {}
"#;

/// The golden messages, also behind a drive, and what is stored of a running tree.
///
/// # Panics
/// When the stored cannot be written.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let line = |(name, json): (&str, &str)| format!("{name} {json}\n");
    let all: String = golden().map(line).collect();
    let edge = golden().find(|(_, json)| json.starts_with(r#"{"component":"edge""#));
    let edge = edge.map(line).expect("a robot's model");
    let edge = edge.replace(r#""schema":2"#, &format!("\"schema\":{SCHEMA_VERSION}"));
    let cells = vec!["0"; (TILE * TILE) as usize].join(",");
    let drive = DRIVE.replace("ROBOT\n", &edge).replace("CELLS", &cells);
    let Restored { goals, tree, .. } = play(GOAL.as_bytes()).1;
    let goals = goals.iter().map(|goal| line(("StoredGoal", &*text(goal))));
    let trees = tree.iter().map(|tree| line(("RunningTree", &*text(tree))));
    let stored: String = goals.chain(trees).collect();
    let paused_for_ever = stored.replace("\"paused_secs\":0.0", "\"paused_secs\":1e300");
    let driven = drive.clone() + &all;
    [driven, drive, stored, paused_for_ever].map(String::into_bytes).into()
}

/// Gives each line to a mission, which carries on to the end; then restarts it from what it stored.
///
/// # Panics
/// When something that it publishes or stores cannot be read again.
pub fn exercise(bytes: &[u8]) -> usize {
    let (taken, restored) = play(bytes);
    let mut restarted = Mission::new(config(), restored);
    for step in 0..STEPS_AFTER {
        let _ = restarted.step(Stamp::from_secs(START + PERIOD * f64::from(step)), Inputs::default());
    }
    taken
}

fn config() -> MissionConfig {
    MissionConfig::new(Id::robot("tiago").expect("a name"), "mission-a", "unused.redb".into())
}

/// Number of lines that were taken, and what was stored.
fn play(bytes: &[u8]) -> (usize, Restored) {
    let mut mission = Mission::new(config(), Restored::fresh());
    let mut asked = Vec::new();
    let mut restored = Restored {
        incarnation: 2,
        ..Restored::default()
    };
    let mut taken = 0;
    for line in bytes.split(|byte| *byte == b'\n').take(MOST_STEPS) {
        if keep_stored(line, &mut restored) {
            taken += 1;
        }
        let Some(inputs) = inputs(line, &mut asked) else {
            continue;
        };
        taken += 1;
        let now = Stamp::from_secs(START + PERIOD * taken as f64);
        for effect in mission.step(now, inputs) {
            carry_out(effect, &mut asked, &mut restored);
        }
    }
    (taken, restored)
}

/// Name and JSON of a line.
fn named(line: &[u8]) -> Option<(&[u8], &[u8])> {
    let at = line.iter().position(|byte| *byte == b' ')?;
    Some((&line[..at], &line[at + 1..]))
}

/// A line of what was stored before; whether it is one.
fn keep_stored(line: &[u8], restored: &mut Restored) -> bool {
    match named(line) {
        Some((b"StoredGoal", json)) => read(json).map(|goal| restored.goals.push(goal)).is_some(),
        Some((b"RunningTree", json)) => read(json).map(|tree| restored.tree = Some(tree)).is_some(),
        _ => false,
    }
}

/// The inputs of a line: a message of this name, as the answer to the oldest request for one.
fn inputs(line: &[u8], asked: &mut Vec<(Ticket, Ask)>) -> Option<Inputs> {
    let (name, json) = named(line)?;
    let mut inputs = Inputs::default();
    let request = |request| vec![(Client(1), request)];
    let mut reply = |fits: fn(&Ask) -> bool, answer: Result<Answer, NoAnswer>| {
        let at = asked.iter().position(|(_, ask)| fits(ask));
        let ticket = at.map(|at| asked.remove(at).0);
        ticket.map(|ticket| (ticket, answer)).into_iter().collect()
    };
    match name {
        b"EdgeState" => inputs.state = Some(read(json)?),
        b"PoseEstimate" => inputs.pose = Some(read(json)?),
        b"Yield" => inputs.yields = Some(read(json)?),
        b"Event" => inputs.events = vec![read(json)?],
        b"MapInfo" => inputs.map_info = Some(read(json)?),
        b"MapPatch" => inputs.map_patches = vec![read(json)?],
        b"Localisation" => inputs.localisation = Some(read(json)?),
        b"MapFrame" => inputs.map_frame = Some(read(json)?),
        b"Annotations" => inputs.annotations = Some(read(json)?),
        b"GoalRequest" => inputs.requests = request(MissionRequest::Goal(read(json)?)),
        b"CancelRequest" => inputs.requests = request(MissionRequest::Cancel(read(json)?)),
        b"PauseRequest" => inputs.requests = request(MissionRequest::Pause(read(json)?)),
        b"MoveGoalRequest" => inputs.requests = request(MissionRequest::MoveGoal(read(json)?)),
        b"GoalsRequest" => inputs.requests = request(MissionRequest::Goals(read(json)?)),
        b"InfoRequest" => inputs.requests = request(MissionRequest::Info(read(json)?)),
        b"JoinRequest" => inputs.requests = request(MissionRequest::Join(read(json)?)),
        b"LeaseReply" => inputs.answers = reply(|ask| matches!(ask, Ask::Lease(_)), Ok(Answer::Lease(read(json)?))),
        b"InfoReply" => {
            inputs.answers = reply(|ask| matches!(ask, Ask::EdgeInfo(_)), Ok(Answer::EdgeInfo(read(json)?)))
        }
        b"BehaviourReply" => {
            inputs.answers = reply(
                |ask| matches!(ask, Ask::Behaviour(_)),
                Ok(Answer::Behaviour(read(json)?)),
            );
        }
        b"MotionReply" => inputs.answers = reply(|ask| matches!(ask, Ask::Motion(_)), Ok(Answer::Motion(read(json)?))),
        b"MapReply" => inputs.answers = reply(|ask| matches!(ask, Ask::Map(_)), Ok(Answer::Map(read(json)?))),
        b"LocaliseReply" => {
            inputs.answers = reply(
                |ask| matches!(ask, Ask::Localise(_)),
                Ok(Answer::Localised(read(json)?)),
            );
        }
        b"RemoteReply" => inputs.answers = reply(|ask| matches!(ask, Ask::Remote(..)), Ok(Answer::Remote(read(json)?))),
        b"Refusal" => inputs.answers = reply(|_| true, Err(NoAnswer::Refused(read(json)?))),
        _ => return None,
    }
    Some(inputs)
}

fn text(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("JSON")
}

fn read<T: DeserializeOwned>(json: &[u8]) -> Option<T> {
    codec::decode(json, Encoding::Json, usize::MAX).ok()
}

/// Keeps requests and records; whatever is published or stored can be read again.
fn carry_out(effect: Effect, asked: &mut Vec<(Ticket, Ask)>, restored: &mut Restored) {
    match effect {
        Effect::Persist(records) => records.into_iter().for_each(|record| keep(record, restored)),
        Effect::Heartbeat(heartbeat) => drop(again(&heartbeat)),
        Effect::Plan(plan) => drop(again(&plan)),
        Effect::Status(status) => drop(again(&status)),
        Effect::Goal(goal) => drop(again(&goal)),
        Effect::Ask(ticket, ask) => asked.push((ticket, ask)),
        Effect::Reply(_, Ok(MissionReply::Goals(reply))) => drop(again(&reply)),
        Effect::Reply(..) | Effect::StandBy => {}
    }
}

fn keep(record: Record, restored: &mut Restored) {
    match record {
        Record::Goal(goal) => {
            restored.goals.retain(|kept| kept.state.id != goal.state.id);
            restored.goals.push(again(&*goal));
        }
        Record::ForgetGoal(id) => restored.goals.retain(|kept| kept.state.id != id),
        Record::Tree(tree) => restored.tree = tree.map(|tree| again(&*tree)),
        Record::Motion(plan) => restored.motion = plan.map(|plan| again(&*plan)),
        Record::Answer(id, reply) => restored.answers.push((id, again(&reply))),
        Record::ForgetAnswer(id) => restored.answers.retain(|(kept, _)| *kept != id),
        Record::Now(stamp) => restored.now = stamp,
    }
}

/// Written as JSON and read.
fn again<T: Serialize + DeserializeOwned>(value: &T) -> T {
    let text = serde_json::to_vec(value).expect("JSON");
    serde_json::from_slice(&text).unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&text)))
}
