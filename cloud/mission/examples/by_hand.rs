//! A mission's core stepped by hand, without a robot, network or disk. A goal with its own tree is submitted, the robot's lease is granted,
//! and every effect is printed in the order in which a service would carry it out.
//!
//! `cargo run -p zenav-mission --example by_hand`
#![allow(clippy::print_stdout, reason = "an example")]

use zenav_mission::{Answer, Ask, Client, Effect, Inputs, Mission, MissionConfig, Restored};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{GoalRequest, LeaseReply};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::MissionRequest;

const TREE: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="Main">
    <Sequence><Wait name="settle" wait_duration="0.2"/><ScriptCondition code="cups == 2"/></Sequence>
</BehaviorTree></root>"#;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let config = MissionConfig::new(Id::robot("tiago")?, "by-hand", "unused".into());
    let mut mission = Mission::new(config, Restored::fresh());
    let goal = GoalRequest {
        id: Some("brew".to_owned()),
        tree: Some(TREE.to_owned()),
        blackboard: [("cups".to_owned(), 2.into())].into(),
        ..GoalRequest::default()
    };
    let mut inputs = Inputs {
        requests: vec![(Client(1), MissionRequest::Goal(goal))],
        ..Inputs::default()
    };
    for step in 0..40 {
        let now = Stamp::from_secs(1.0 + 0.05 * f64::from(step));
        for effect in mission.step(now, std::mem::take(&mut inputs)) {
            match effect {
                Effect::Persist(records) => println!("{step:2}  persist {} records", records.len()),
                Effect::Ask(ticket, Ask::Lease(request)) => {
                    println!("{step:2}  {} requests the lease", request.holder);
                    let reply = LeaseReply {
                        epoch: 1,
                        ttl_secs: 1.0,
                        boot_id: "boot".to_owned(),
                        round_trip_secs: None,
                    };
                    inputs.answers.push((ticket, Ok(Answer::Lease(reply))));
                }
                Effect::Reply(client, reply) => println!("{step:2}  reply to client {}: {reply:?}", client.0),
                Effect::Goal(goal) => {
                    println!("{step:2}  goal {} is {:?}", goal.id, goal.state);
                    if goal.state.is_end() {
                        return Ok(());
                    }
                }
                _ => {}
            }
        }
    }
    Err("the goal did not end within two seconds".into())
}
