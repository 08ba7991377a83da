//! Claims about a robot without a valid pose.

use zenav_mission::Ask;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{BehaviourAction, GoalPhase, Health, Localisation, LocaliseAction};
use zenav_protocol::time::Stamp;

use crate::rig::{Rig, to};

fn say(rig: &mut Rig, health: Health) {
    let boot_id = rig.state.as_ref().unwrap().boot_id.clone();
    let said = Localisation {
        stamp: Stamp::ZERO,
        boot_id,
        health,
        map_from_base: Pose2::IDENTITY,
        agreeing: 0.1,
        through_walls: 0.5,
    };
    rig.stage.robots[0].inputs.localisation = Some(said.clone());
    rig.stage.robots[0].inbox.localisations.push(said);
}

#[test]
fn a_robot_that_is_lost_is_looked_for_turns_and_ends_its_goal_as_lost() {
    let mut rig = Rig::new();
    rig.submit(to(3.0, 0.0, "g")).unwrap();
    assert!(rig.run_until(20.0, |rig| rig.driven() > 0.3));
    say(&mut rig, Health::Lost);
    assert!(rig.run_until(60.0, |rig| rig.phase("g").is_end()));
    assert_eq!(rig.phase("g"), GoalPhase::Aborted);
    let reason = rig.goal("g").reason.clone().unwrap();
    assert!(
        reason.starts_with("Lost: nobody knows where the robot is (lost)"),
        "{reason}"
    );
    // The robot was still turning.
    rig.run(1.0);
    assert!(rig.is_at_rest() && rig.driven() < 1.5, "{}", rig.driven());
    let asked = |is: fn(&Ask) -> bool| rig.asked.iter().filter(|ask| is(ask)).count();
    let searches = asked(
        |ask| matches!(ask, Ask::Localise(request) if request.action == LocaliseAction::Global && request.epoch.is_some()),
    );
    assert_eq!(searches, 2);
    assert!(
        asked(|ask| matches!(ask, Ask::Behaviour(request) if matches!(request.action, BehaviourAction::Spin { .. })))
            >= 2
    );
}

#[test]
fn a_robot_that_goes_by_its_own_estimate_drives_on_but_arrives_nowhere_while_its_beams_pass_through_walls() {
    let mut rig = Rig::new();
    rig.submit(to(3.0, 0.0, "g")).unwrap();
    assert!(rig.run_until(20.0, |rig| rig.driven() > 0.3));
    say(&mut rig, Health::Contradicted);
    assert!(rig.run_until(20.0, |rig| rig.driven() > 2.0));
    say(&mut rig, Health::Contradicted);
    let goal = rig.end_of("g", 60.0);
    assert!(rig.distance(3.0, 0.0) < 0.3, "{:?}", rig.pose());
    let reason = goal.reason.unwrap_or_default();
    assert!(
        goal.state == GoalPhase::Aborted && reason.contains("arrived by the robot's own estimate alone: 50 %"),
        "{:?} {reason}",
        goal.state
    );
    // Nobody can look for it, and no recovery would help.
    let recoveries = |ask: &&Ask| matches!(ask, Ask::Localise(_) | Ask::Behaviour(_));
    assert_eq!(rig.asked.iter().filter(recoveries).count(), 0);
    say(&mut rig, Health::Tracking);
    rig.submit(to(0.0, 0.0, "back")).unwrap();
    rig.success_of("back", 60.0);
}

#[test]
fn a_robot_that_is_found_again_goes_on_to_its_goal() {
    let mut rig = Rig::new();
    rig.submit(to(3.0, 0.0, "g")).unwrap();
    assert!(rig.run_until(20.0, |rig| rig.driven() > 0.3));
    say(&mut rig, Health::Searching);
    rig.run(1.0);
    say(&mut rig, Health::Lost);
    rig.run(1.0);
    let driven = rig.driven();
    rig.run(1.0);
    assert!(rig.driven() < driven + 0.02, "it drives while it is lost");
    say(&mut rig, Health::Tracking);
    assert!(rig.run_until(60.0, |rig| rig.phase("g").is_end()));
    assert_eq!(rig.phase("g"), GoalPhase::Succeeded, "{:?}", rig.goal("g").reason);
}
