//! Claims about maneuvers that the robot executes itself.

use std::collections::BTreeSet;

use zenav_mission::Ask;
use zenav_protocol::messages::{BehaviourAction, GoalPhase};

use super::rig::{Rig, cancel, tree};

const TREE: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Sequence>
    <Spin spin_dist="1.0"/><BackUp backup_dist="0.3" backup_speed="0.05"/><DriveOnHeading dist_to_travel="0.4" speed="0.2"/>
    <DriveToFree clearance="0.2" within="1.5"/></Sequence></BehaviorTree></root>"#;

/// Executions that the robot was asked to start, in order, each once.
fn begun(rig: &Rig) -> Vec<BehaviourAction> {
    let mut seen = BTreeSet::new();
    let asked = rig.asked.iter().filter_map(|ask| match ask {
        Ask::Behaviour(request) => Some(request),
        _ => None,
    });
    asked
        .filter(|request| !matches!(request.action, BehaviourAction::Report) && seen.insert(&request.id))
        .map(|request| request.action.clone())
        .collect()
}

#[test]
fn each_is_asked_of_the_robot_by_an_id_of_its_own_with_what_its_ports_say() {
    let mut rig = Rig::new();
    rig.submit(tree(TREE, "g")).unwrap();
    rig.success_of("g", 30.0);
    assert_eq!(
        begun(&rig),
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
    assert!((rig.pose().yaw - 1.0).abs() < 0.1 && (rig.driven() - 0.7).abs() < 0.1);
}

#[test]
fn a_pause_and_a_cancel_of_the_goal_end_the_one_that_is_under_way() {
    for pauses in [true, false] {
        let mut rig = Rig::new();
        rig.submit(tree(TREE, "g")).unwrap();
        assert!(rig.run_until(10.0, |rig| begun(rig).len() == 2));
        rig.run(1.5);
        assert!(rig.driven() > 0.03, "it backs up");
        if pauses {
            rig.pause(false);
        } else {
            rig.answer(cancel(Some("g"), "c")).unwrap();
        }
        rig.run(0.5);
        let driven = rig.driven();
        rig.run(3.0);
        assert!(
            rig.is_at_rest() && rig.driven() - driven < 0.005,
            "{pauses}: it goes on"
        );
    }
}

#[test]
fn a_restart_asks_on_for_the_same_execution() {
    let mut rig = Rig::new();
    rig.submit(tree(TREE, "g")).unwrap();
    let backs_up = |rig: &Rig| begun(rig).len() == 2;
    assert!(rig.run_until(10.0, backs_up));
    rig.run(1.0);
    rig.kill();
    rig.run(0.5);
    rig.start();
    rig.run(2.0);
    assert!(
        backs_up(&rig) && rig.phase("g") == GoalPhase::Active,
        "{:?}",
        begun(&rig)
    );
    rig.success_of("g", 30.0);
    assert_eq!(begun(&rig).len(), 4);
    assert!((rig.driven() - 0.7).abs() < 0.1, "nothing is done twice");
}
