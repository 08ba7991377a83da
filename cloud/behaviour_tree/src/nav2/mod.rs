//! Nav2's nodes (nav2_behavior_tree 1.5). Which nodes does a Nav2 tree need besides BehaviorTree.CPP's?
//!
//! | module | answers |
//! |---|---|
//! | `controls`, `pause` | controls and decorators that need no robot |
//! | `decorators` | decorators that follow a robot or its goals, over [`Travel`] |
//! | `conditions` | conditions that depend only on the blackboard and the time |
//! | `specs` | all other Nav2 nodes, declared with their ports |
//! | `literals` | how poses, lists of poses and paths are written in a tree |
//! | `scripted` | the same nodes against scripted leaves ([`crate::simulate`]) |
//!
//! Known Nav2 bugs are reproduced by default; a port selects the corrected behaviour (`last_may_succeed` of RoundRobin).

mod conditions;
mod controls;
mod decorators;
mod literals;
mod pause;
mod scripted;
mod specs;

use crate::nodes::{self, PauseEntries, Row, control};
use crate::ports::PortType::{Bool, Int, Positive, Text, Unsigned};
use crate::registry::{NodeSpec, Registry};

pub use conditions::{MakeCondition, condition, off_path};
pub use decorators::{MakeDecorator, Measure, Travel, decorator};
pub use literals::{Pose, nav2_list, pose, pose_of_json};
pub(crate) use scripted::{registry as scripted_registry, scripted_condition, succeed};
pub use specs::specs;

use controls::{
    NonblockingSequence, PersistentSequence, PipelineSequence, RateController, RecoveryNode, RoundRobin, SingleTrigger,
};
use pause::PauseResume;

/// BehaviorTree.CPP's nodes, and Nav2's controls and decorators that need no robot; literals in Nav2's format.
///
/// ```
/// use zenav_behaviour_tree::{Status, build, nav2};
///
/// let registry = nav2::controls::<()>();
/// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main">
///     <RecoveryNode number_of_retries="2"><AlwaysFailure/><AlwaysSuccess/></RecoveryNode>
/// </BehaviorTree></root>"#;
/// let mut tree = build("retry.xml", text.as_bytes(), &registry, None, &mut |_, _| Err("no includes".into())).unwrap();
/// assert_eq!(tree.tick(std::time::Duration::ZERO, &mut ()).unwrap(), Status::Failure);
/// assert_eq!(tree.report()[1].starts, 3, "once, and twice after a recovery");
/// ```
pub fn controls<C>() -> Registry<C> {
    let mut registry = Registry::new();
    registry.add_builtins(rows());
    registry.literals(literals::RULES);
    registry
}

/// All of Nav2's nodes for trees that drive the robot of a context: [`controls`], the decorators, and the conditions that depend only on
/// the blackboard. All others are declared: a leaf registered under the same id implements them.
///
/// ```
/// use zenav_behaviour_tree::{Value, nav2};
///
/// struct Robot;
/// impl nav2::Travel for Robot {
///     fn position(&self) -> Option<[f64; 2]> {
///         Some([0.0, 0.0])
///     }
///     fn speed(&self) -> f64 {
///         0.5
///     }
///     fn measure(&self, _: &Value) -> Option<nav2::Measure> {
///         None
///     }
/// }
/// let registry = nav2::registry::<Robot>();
/// let declared = |id: &str| registry.declared().any(|spec| spec.id == id);
/// assert!(declared("ComputePathToPose") && !declared("DistanceController"));
/// ```
pub fn registry<C: Travel + 'static>() -> Registry<C> {
    let mut registry = controls();
    for spec in specs() {
        let added = if let Some(make) = decorator(&spec.id) {
            registry.decorator(spec, move |_| make())
        } else if let Some(make) = condition(&spec.id) {
            registry.leaf(spec, move |_| make())
        } else {
            registry.declare(spec);
            Ok(())
        };
        debug_assert!(added.is_ok(), "{added:?}");
    }
    registry
}

/// Nav2's controls and decorators that need no robot.
fn rows<C>() -> Vec<Row<C>> {
    nodes::table! { ports:
        control("PipelineSequence", "A Sequence that ticks earlier children again while later ones run.") => PipelineSequence;
        NodeSpec::control("RecoveryNode", "Child 1; when it fails, child 2 and child 1 again.", 2, 2)
            .input_or("number_of_retries", Unsigned, "1", "how often child 2 may recover")
            => RecoveryNode { number_of_retries: ports.source("number_of_retries") };
        control("RoundRobin", "One child per activation, in turn.")
            .input_or("wrap_around", Bool, "false", "start over after the last child")
            .input_or(
                "last_may_succeed",
                Bool,
                "false",
                "without wrap_around, let success of the last child count (Nav2 makes it a failure)",
            )
            => RoundRobin {
                wrap_around: ports.source("wrap_around"),
                last_may_succeed: ports.source("last_may_succeed"),
            };
        control("NonblockingSequence", "A Sequence that ticks every child in every tick.") => NonblockingSequence;
        control("PersistentSequence", "A Sequence whose index is a blackboard entry.")
            .inout("current_child_idx", Int, "index of the current child")
            => PersistentSequence { current_child_idx: ports.source("current_child_idx") };
        NodeSpec::control(
            "PauseResumeController",
            "Child 1 while not paused, 2 while paused; 3 on pausing, 4 on resuming.",
            1,
            4,
        )
            .input_or("pause_service_name", Text, "pause", "entry of the root blackboard: a write to it asks to pause")
            .input_or("resume_service_name", Text, "resume", "entry of the root blackboard: a write to it asks to resume")
            => PauseResume(PauseEntries {
                pause: ports.root_slot("pause_service_name"),
                resume: ports.root_slot("resume_service_name"),
            });
        NodeSpec::decorator("RateController", "Ticks the child at a rate.").input_or("hz", Positive, "10.0", "rate, 1/s")
            => RateController { hz: ports.source("hz") };
        NodeSpec::decorator("SingleTrigger", "Runs the child once per activation.") => SingleTrigger;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_default_is_a_value_of_its_port() {
        for (spec, _) in rows::<()>().into_iter().chain(nodes::rows()) {
            for port in &spec.ports {
                if let Some(default) = &port.default {
                    assert!(port.kind.parse(default).is_some(), "{} {}", spec.id, port.name);
                }
            }
        }
    }
}
