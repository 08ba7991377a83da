//! Claims about motions that the robot carries out by itself.

use std::collections::BTreeSet;

use zenav_protocol::messages::*;
use zenav_protocol::topics::MissionRequest;

use super::rig::Rig;
use crate::io::Ask;

const TREE: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Sequence>
    <Spin spin_dist="1.0"/><BackUp backup_dist="0.3" backup_speed="0.05"/><DriveOnHeading dist_to_travel="0.4" speed="0.2"/>
    <DriveToFree clearance="0.2" within="1.5"/></Sequence></BehaviorTree></root>"#;

fn begin() -> Rig {
    let mut rig = Rig::new();
    let goal = GoalRequest {
        id: Some("g".into()),
        tree: Some(TREE.into()),
        ..GoalRequest::default()
    };
    rig.answer(MissionRequest::Goal(goal)).unwrap();
    rig
}

/// Executions that the robot was asked to begin, in order, each once.
fn begun(rig: &Rig) -> Vec<(String, BehaviourAction)> {
    let mut seen = BTreeSet::new();
    let asked = rig.asked.iter().filter_map(|ask| match ask {
        Ask::Behaviour(request) => Some((request.id.clone(), request.action.clone())),
        _ => None,
    });
    asked
        .filter(|(id, action)| !matches!(action, BehaviourAction::Report) && seen.insert(id.clone()))
        .collect()
}

#[test]
fn each_is_asked_of_the_robot_by_an_id_of_its_own_with_what_its_ports_say() {
    let mut rig = begin();
    assert!(rig.run_until(30.0, |rig| rig.state("g").is_end()));
    assert_eq!(rig.state("g"), GoalPhase::Succeeded);
    let actions: Vec<BehaviourAction> = begun(&rig).into_iter().map(|(_, action)| action).collect();
    assert_eq!(
        actions,
        [
            BehaviourAction::Spin { angle: 1.0 },
            BehaviourAction::Drive {
                distance: -0.3,
                speed: 0.05
            },
            BehaviourAction::Drive {
                distance: 0.4,
                speed: 0.2
            },
            BehaviourAction::ToFree {
                clearance: 0.2,
                within: 1.5
            },
        ]
    );
}

#[test]
fn a_restart_asks_on_for_the_same_execution() {
    let mut rig = begin();
    rig.behaviours_run = true;
    rig.run(3.0);
    rig.kill();
    rig.run(1.0);
    rig.start();
    rig.run(3.0);
    assert_eq!(begun(&rig).len(), 1, "{:?}", begun(&rig));
    rig.behaviours_run = false;
    assert!(rig.run_until(30.0, |rig| rig.state("g").is_end()));
    assert_eq!((rig.state("g"), begun(&rig).len()), (GoalPhase::Succeeded, 4));
}
