//! Tests of Nav2's decorators that follow a robot or its goals, its blackboard conditions, and the control that pauses on request.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::nav2::{self, Measure, Travel};
use crate::{Leaf, LeafIo, NodeSpec, PortType, Status, Tree, Value, build};

/// A robot on a line; paths are texts `from;to;length`, and the robot is at the start of each.
#[derive(Default)]
struct Robot {
    at: f64,
    speed: f64,
    lost: bool,
    log: Vec<String>,
    calls: BTreeMap<String, usize>,
}

impl Travel for Robot {
    fn position(&self) -> Option<[f64; 2]> {
        (!self.lost).then_some([self.at, 0.0])
    }
    fn speed(&self) -> f64 {
        self.speed
    }
    fn measure(&self, path: &Value) -> Option<Measure> {
        let text = path.to_string();
        let (end, length) = text.split_once(';')?;
        Some(Measure {
            end: [end.parse().ok()?, 0.0],
            length: length.parse().ok()?,
            left: length.parse().ok()?,
        })
    }
}

/// As the leaves of the other tests: one letter per call, the last repeats forever.
struct Planned;

impl Leaf<Robot> for Planned {
    fn start(&mut self, io: &mut LeafIo<'_>, robot: &mut Robot) -> Status {
        robot.log.push(io.name().to_owned());
        let plan: String = io.get("plan").unwrap();
        let call = robot.calls.entry(io.name().to_owned()).or_default();
        let letter = plan.chars().nth(*call).or(plan.chars().last());
        *call += 1;
        match letter {
            Some('S') => Status::Success,
            Some('F') => Status::Failure,
            _ => Status::Running,
        }
    }
    fn halt(&mut self, io: &mut LeafIo<'_>, robot: &mut Robot) {
        robot.log.push(format!("{}!", io.name()));
    }
}

struct Stand {
    tree: Tree<Robot>,
    robot: Robot,
}

impl Stand {
    fn new(body: &str) -> Stand {
        let mut registry = nav2::registry();
        let planned = NodeSpec::action("T", "answers by a plan").input_or("plan", PortType::Text, "S", "answers");
        registry.leaf(planned, |_| Box::new(Planned)).unwrap();
        let text = format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"Main\">{body}</BehaviorTree></root>");
        let tree = build(
            "t.xml",
            text.as_bytes(),
            &registry,
            None,
            &mut |_, _| Err("none".into()),
        )
        .unwrap_or_else(|errors| panic!("{errors}"));
        Stand {
            tree,
            robot: Robot::default(),
        }
    }

    fn set(&mut self, key: &str, value: impl Into<Value>) -> &mut Stand {
        self.tree.blackboard_mut().set(key, value).unwrap();
        self
    }

    fn at(&mut self, ms: u64) -> Status {
        self.tree.tick(Duration::from_millis(ms), &mut self.robot).unwrap()
    }

    fn log(&mut self) -> String {
        std::mem::take(&mut self.robot.log).join(" ")
    }
}

use Status::{Failure, Running, Success};

#[test]
fn distance_controller_ticks_on_activation_while_running_and_a_distance_from_the_last_success() {
    let mut stand = Stand::new(
        "<Repeat num_cycles=\"-1\"><DistanceController distance=\"1.0\"><T name=\"a\" plan=\"RSS\"/></DistanceController></Repeat>",
    );
    let mut stand_alone = Stand::new(
        "<PipelineSequence><DistanceController distance=\"1.0\"><T name=\"a\" plan=\"RSS\"/></DistanceController><T name=\"b\" plan=\"R\"/></PipelineSequence>",
    );
    stand.at(0);
    assert_eq!(stand.log(), "a");
    assert_eq!((stand_alone.at(0), stand_alone.log().as_str()), (Running, "a"));
    stand_alone.robot.at = 0.5;
    assert_eq!((stand_alone.at(10), stand_alone.log().as_str()), (Running, "a b"));
    stand_alone.robot.at = 1.4;
    assert_eq!((stand_alone.at(20), stand_alone.log().as_str()), (Running, "b"));
    stand_alone.robot.at = 1.5;
    assert_eq!((stand_alone.at(30), stand_alone.log().as_str()), (Running, "a b"));
    stand_alone.robot.lost = true;
    assert_eq!(stand_alone.at(40), Failure, "nobody knows where the robot is");
}

#[test]
fn a_failure_of_the_child_goes_through_every_rhythm() {
    for open in [
        "DistanceController",
        "SpeedController",
        "GoalUpdatedController",
        "RateController",
    ] {
        let mut stand = Stand::new(&format!("<{open}><T plan=\"F\"/></{open}>"));
        assert_eq!(stand.at(0), Failure, "{open}");
    }
}

#[test]
fn speed_controller_goes_by_the_speed_at_the_end_of_each_period_and_begins_anew_with_a_new_goal() {
    let mut stand = Stand::new(
        "<PipelineSequence><SpeedController min_rate=\"0.1\" max_rate=\"1.0\" min_speed=\"0.0\" max_speed=\"0.5\"><T name=\"a\"/></SpeedController><T name=\"b\" plan=\"R\"/></PipelineSequence>",
    );
    stand.set("goal", "1;1");
    stand.at(0);
    stand.at(990);
    assert_eq!(stand.log(), "a b b");
    // The first period is that of the greatest rate; at rest the next is that of the least rate.
    stand.at(1000);
    stand.at(10_990);
    assert_eq!(stand.log(), "a b b");
    stand.robot.speed = 0.25;
    stand.at(11_000);
    assert_eq!(stand.log(), "a b");
    // 0.55 per second.
    stand.at(11_000 + 1810);
    assert_eq!(stand.log(), "b");
    stand.at(11_000 + 1820);
    assert_eq!(stand.log(), "a b");
    stand.set("goal", "2;2");
    stand.at(11_000 + 1830);
    assert_eq!(stand.log(), "a b");
}

#[test]
fn goal_updated_controller_ticks_on_activation_on_a_new_goal_and_while_running() {
    let mut stand = Stand::new(
        "<PipelineSequence><GoalUpdatedController><T name=\"a\" plan=\"RSRS\"/></GoalUpdatedController><T name=\"b\" plan=\"R\"/></PipelineSequence>",
    );
    stand.set("goal", "1;1");
    stand.at(0);
    stand.at(10);
    stand.at(20);
    assert_eq!(stand.log(), "a a b b");
    stand.set("goal", "1;1");
    stand.at(30);
    assert_eq!(stand.log(), "b", "an equal goal is no new one");
    stand.set("goal", "2;2");
    stand.at(40);
    stand.at(50);
    stand.at(60);
    assert_eq!(stand.log(), "a b a b b");
}

#[test]
fn goal_updater_takes_an_update_that_is_not_older_and_has_a_stamp() {
    let mut stand = Stand::new("<GoalUpdater input_goal=\"{goal}\" output_goal=\"{target}\"><T/></GoalUpdater>");
    let target = |stand: &Stand| {
        stand
            .tree
            .blackboard()
            .get("target")
            .map(ToString::to_string)
            .unwrap_or_default()
    };
    stand.set("goal", r#"{"x": 1, "y": 1, "stamp": 10}"#);
    assert_eq!(stand.at(0), Success);
    assert!(target(&stand).contains("\"x\": 1"));
    for (update, taken) in [
        (r#"{"x": 2, "y": 1}"#, false),
        (r#"{"x": 3, "y": 1, "stamp": 9}"#, false),
        (r#"{"x": 4, "y": 1, "stamp": 10}"#, true),
        (r#"{"x": 5, "y": 1, "stamp": 11}"#, true),
    ] {
        stand.set("goal_update", update);
        stand.at(10);
        assert_eq!(target(&stand) == update, taken, "{update}");
    }
}

#[test]
fn path_longer_on_approach_ticks_its_child_for_a_much_longer_path_to_the_same_goal_when_near() {
    let body = "<PathLongerOnApproach path=\"{path}\" prox_len=\"3.0\" length_factor=\"2.0\"><T name=\"a\" plan=\"RSS\"/></PathLongerOnApproach>";
    for (old, new, ticked) in [
        ("9;2.0", "9;4.1", true),
        ("9;2.0", "9;4.0", false),
        ("9;2.0", "9;3.9", false),
        ("9;3.5", "9;9.0", false),
        ("9;2.0", "8;9.0", false),
        ("9;2.0", "9;2.0", false),
    ] {
        let mut stand = Stand::new(body);
        stand.set("path", old);
        assert_eq!(
            (stand.at(0), stand.log().as_str()),
            (Success, ""),
            "the first path is no longer one"
        );
        stand.set("path", new);
        let expected = if ticked { (Running, "a") } else { (Success, "") };
        assert_eq!((stand.at(10), stand.log().as_str()), expected, "{old} {new}");
        if ticked {
            // To completion, and not again for the same path.
            assert_eq!((stand.at(20), stand.log().as_str()), (Success, "a"));
            assert_eq!((stand.at(30), stand.log().as_str()), (Success, ""));
        }
    }
}

#[test]
fn goal_updated_remembers_from_its_activation_and_global_updated_goal_for_life() {
    let mut once = Stand::new(
        "<KeepRunningUntilFailure><ForceSuccess><WhileDoElse><GoalUpdated/><T name=\"new\" plan=\"R\"/><T name=\"old\" plan=\"R\"/></WhileDoElse></ForceSuccess></KeepRunningUntilFailure>",
    );
    once.set("goal", "1;1");
    once.at(0);
    once.at(10);
    assert_eq!(once.log(), "old old");
    once.set("goal", "2;2");
    once.at(20);
    once.at(30);
    assert_eq!(once.log(), "old! new new! old", "a change is told once");

    let mut life = Stand::new("<Fallback><GlobalUpdatedGoal/><T name=\"old\" plan=\"F\"/></Fallback>");
    life.set("goal", "1;1");
    assert_eq!(life.at(0), Success, "the very first tick");
    assert_eq!(life.at(10), Failure);
    life.set("goals", "3;3");
    assert_eq!(life.at(20), Success);
    assert_eq!(life.at(30), Failure, "also after its parent has reset it");
}

#[test]
fn would_recovery_help_knows_nav2s_codes_and_others_are_listed() {
    let helps = |node: &str, code: i64| {
        let mut stand = Stand::new(&format!("<{node} error_code=\"{{code}}\"/>"));
        stand.set("code", code);
        stand.at(0) == Success
    };
    for (node, codes) in [
        ("WouldAControllerRecoveryHelp", vec![100, 104, 105, 106]),
        ("WouldAPlannerRecoveryHelp", vec![200, 207, 208, 300, 307, 308]),
    ] {
        let helped: Vec<i64> = (0..1000).filter(|code| helps(node, *code)).collect();
        assert_eq!(helped, codes, "{node}");
    }
    let mut unset = Stand::new("<WouldAControllerRecoveryHelp error_code=\"{code}\"/>");
    assert_eq!(unset.at(0), Failure, "no error, no help");
    let mut listed = Stand::new("<AreErrorCodesPresent error_code=\"{code}\" error_codes_to_check=\"103;7\"/>");
    assert_eq!(listed.set("code", 7).at(0), Success);
    assert_eq!(listed.set("code", 8).at(10), Failure);
}

#[test]
fn pause_resume_controller_runs_the_child_of_its_state_and_those_of_the_change() {
    let mut stand = Stand::new(
        "<PauseResumeController pause_service_name=\"hold\" resume_service_name=\"go\">\
         <T name=\"work\" plan=\"RRRRS\"/><T name=\"wait\" plan=\"R\"/><T name=\"stop\" plan=\"RS\"/><T name=\"warm\" plan=\"S\"/></PauseResumeController>",
    );
    assert_eq!((stand.at(0), stand.log().as_str()), (Running, "work"));
    stand.set("go", true);
    assert_eq!(
        (stand.at(10), stand.log().as_str()),
        (Running, "work"),
        "nothing is paused"
    );
    stand.set("hold", true);
    assert_eq!((stand.at(20), stand.log().as_str()), (Running, "work! stop"));
    assert_eq!((stand.at(30), stand.log().as_str()), (Running, "stop"));
    assert_eq!((stand.at(40), stand.log().as_str()), (Running, "wait"));
    stand.set("hold", true);
    assert_eq!(
        (stand.at(50), stand.log().as_str()),
        (Running, "wait"),
        "it is paused already"
    );
    stand.set("go", true);
    assert_eq!((stand.at(60), stand.log().as_str()), (Running, "wait! warm"));
    assert_eq!((stand.at(70), stand.log().as_str()), (Running, "work"));
    assert_eq!((stand.at(80), stand.log().as_str()), (Running, "work"));
    assert_eq!((stand.at(90), stand.log().as_str()), (Success, "work"));
}

#[test]
fn a_pause_without_a_child_for_it_only_waits_and_a_failure_ends_it() {
    let mut stand = Stand::new("<PauseResumeController><T name=\"work\" plan=\"RRF\"/></PauseResumeController>");
    stand.set("pause", 1);
    assert_eq!(
        (stand.at(0), stand.log().as_str()),
        (Running, ""),
        "asked before it was there"
    );
    assert_eq!((stand.at(5), stand.log().as_str()), (Running, ""));
    stand.set("resume", 1);
    assert_eq!((stand.at(10), stand.log().as_str()), (Running, ""));
    assert_eq!((stand.at(20), stand.log().as_str()), (Running, "work"));
    stand.set("pause", 2);
    stand.set("resume", 2);
    assert_eq!((stand.at(25), stand.log().as_str()), (Running, "work"), "both at once");
    stand.set("pause", 3);
    assert_eq!((stand.at(30), stand.log().as_str()), (Running, "work!"));
    assert_eq!((stand.at(40), stand.log().as_str()), (Running, ""));
    stand.set("resume", 3);
    assert_eq!((stand.at(50), stand.log().as_str()), (Running, ""));
    assert_eq!((stand.at(60), stand.log().as_str()), (Failure, "work"));
}

#[test]
fn a_skipped_child_of_a_pause_resume_controller_counts_as_one_that_succeeded() {
    let mut stand = Stand::new("<PauseResumeController><T name=\"work\" _skipIf=\"true\"/></PauseResumeController>");
    assert_eq!((stand.at(0), stand.log().as_str()), (Success, ""));
}
