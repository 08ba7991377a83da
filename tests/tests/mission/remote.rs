//! Claims about actions carried out by other programs.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use zenav_protocol::messages::{GoalRequest, RemoteAction, RemoteReply, RemoteRequest, RemoteStatus};

use super::rig::{GRIPPER, Rig, cancel, tree};

const TREE: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Sequence>
    <RemoteAction name="Grab" server="kitchen/gripper" item="{item}" weight="{weight}" force="2.5"/>
    <ScriptCondition code="weight == 7"/>
</Sequence></BehaviorTree></root>"#;

/// Requests that the program received, by execution, and the executions it was told to cancel.
#[derive(Default)]
struct Gripper {
    asked: BTreeMap<String, Vec<RemoteRequest>>,
    canceled: Vec<String>,
    /// Number of answers until the end.
    takes: usize,
    fails: bool,
}

impl Gripper {
    fn of(rig: &mut Rig, takes: usize) -> Rc<RefCell<Gripper>> {
        let gripper = Rc::new(RefCell::new(Gripper {
            takes,
            ..Gripper::default()
        }));
        let server = Rc::clone(&gripper);
        rig.remote = Some(Box::new(move |request| server.borrow_mut().answer(request)));
        gripper
    }

    fn answer(&mut self, request: &RemoteRequest) -> RemoteReply {
        let asked = self.asked.entry(request.execution.clone()).or_default();
        if request.action == RemoteAction::Cancel {
            self.canceled.push(request.execution.clone());
        } else {
            asked.push(request.clone());
        }
        let status = match asked.len() < self.takes {
            true => RemoteStatus::Running,
            false if self.fails => RemoteStatus::Failure,
            false => RemoteStatus::Success,
        };
        RemoteReply {
            execution: request.execution.clone(),
            status,
            feedback: "closes".into(),
            outputs: [("weight".to_owned(), 7.into()), ("unasked".to_owned(), 1.into())].into(),
        }
    }
}

fn submit(rig: &mut Rig) {
    let goal = GoalRequest {
        blackboard: [("item".to_owned(), "cup".into())].into(),
        ..tree(TREE, "g")
    };
    rig.submit(goal).unwrap();
}

#[test]
fn it_is_asked_until_it_has_ended_with_its_inputs_and_its_outputs_are_written() {
    let mut rig = Rig::new();
    let gripper = Gripper::of(&mut rig, 4);
    submit(&mut rig);
    rig.success_of("g", 10.0);
    let gripper = gripper.borrow();
    assert_eq!(gripper.asked.len(), 1, "one execution");
    let asked = gripper.asked.values().next().unwrap();
    assert_eq!(asked.len(), 4);
    let expected: BTreeMap<String, serde_json::Value> =
        [("force".to_owned(), "2.5".into()), ("item".to_owned(), "cup".into())].into();
    let first = &asked[0];
    assert_eq!(
        (&first.inputs, first.node.as_str(), first.goal.as_str()),
        (&expected, "Grab", "g")
    );
    assert!(first.epoch > 0 && first.robot == "tiago");
}

#[test]
fn its_failure_is_the_goal_s_with_its_own_words() {
    let mut rig = Rig::new();
    let gripper = Gripper::of(&mut rig, 1);
    gripper.borrow_mut().fails = true;
    submit(&mut rig);
    assert_eq!(rig.end_of("g", 10.0).reason.as_deref(), Some("Grab: closes"));
}

#[test]
fn a_canceled_goal_stops_it() {
    let mut rig = Rig::new();
    let gripper = Gripper::of(&mut rig, usize::MAX);
    submit(&mut rig);
    rig.run(2.0);
    rig.answer(cancel(None, "c1")).unwrap();
    rig.run(1.0);
    let gripper = gripper.borrow();
    assert_eq!(gripper.canceled, gripper.asked.keys().cloned().collect::<Vec<_>>());
}

#[test]
fn a_restart_asks_on_for_the_same_execution() {
    let mut rig = Rig::new();
    let gripper = Gripper::of(&mut rig, 30);
    submit(&mut rig);
    for _ in 0..3 {
        rig.run(1.0);
        rig.kill();
        rig.run(2.0);
        rig.start();
    }
    rig.success_of("g", 30.0);
    assert_eq!(gripper.borrow().asked.len(), 1, "one execution");
}

#[test]
fn nobody_there_is_a_failure_that_names_the_key() {
    let mut rig = Rig::new();
    submit(&mut rig);
    let reason = rig.end_of("g", 30.0).reason.unwrap();
    assert!(reason.contains(GRIPPER), "{reason}");
}
