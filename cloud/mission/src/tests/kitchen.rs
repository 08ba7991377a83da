//! Claims about the kitchen mission.

use zenav_protocol::messages::*;

use super::rig::Rig;
use crate::io::Ask;

fn kitchen() -> GoalRequest {
    GoalRequest {
        id: Some("kitchen".into()),
        tree: Some("kitchen".into()),
        ..GoalRequest::default()
    }
}

#[test]
fn in_a_world_without_its_places_the_mission_says_which_one_it_misses() {
    let mut rig = Rig::new();
    rig.submit(kitchen()).unwrap();
    assert!(rig.run_until(60.0, |rig| rig.state("kitchen").is_end()));
    let reason = rig.goal("kitchen").reason.clone().unwrap();
    assert!(reason.contains("`corner`") && reason.contains("(sink)"), "{reason}");
}

fn names(goal: &GoalState) -> Vec<(&str, GoalPhase)> {
    goal.legs.iter().map(|leg| (leg.name.as_str(), leg.state)).collect()
}

#[test]
fn without_a_map_it_maps_around_the_table_then_drives_to_the_corner_and_the_sink() {
    let mut rig = Rig::in_the_kitchen();
    rig.map.stored = false;
    rig.submit(kitchen()).unwrap();
    assert!(rig.run_until(300.0, |rig| rig.state("kitchen").is_end()));
    let goal = rig.goal("kitchen");
    let done = GoalPhase::Succeeded;
    assert_eq!(goal.state, done, "{:?}", goal.reason);
    assert_eq!(names(goal), [("table", done), ("corner", done), ("sink", done)]);
    let actions: Vec<MapAction> = rig
        .asked
        .iter()
        .filter_map(|ask| match ask {
            Ask::Map(request) if request.action != MapAction::Get => Some(request.action),
            _ => None,
        })
        .collect();
    assert_eq!(actions, [MapAction::Reset, MapAction::Save]);
    assert!((rig.edge.pose.x - 0.88).hypot(rig.edge.pose.y - 0.09) < 0.1);
}

#[test]
fn with_a_stored_map_it_drives_at_once() {
    let mut rig = Rig::in_the_kitchen();
    rig.submit(kitchen()).unwrap();
    assert!(rig.run_until(100.0, |rig| rig.state("kitchen").is_end()));
    let done = GoalPhase::Succeeded;
    assert_eq!(names(rig.goal("kitchen")), [("corner", done), ("sink", done)]);
}

#[test]
fn a_restart_on_the_mapping_drive_keeps_the_map_and_the_place_in_the_loop() {
    let mut rig = Rig::in_the_kitchen();
    rig.map.stored = false;
    rig.submit(kitchen()).unwrap();
    rig.run(25.0);
    rig.kill();
    rig.run(10.0);
    rig.start();
    assert!(rig.run_until(300.0, |rig| rig.state("kitchen").is_end()));
    let goal = rig.goal("kitchen");
    let done = GoalPhase::Succeeded;
    assert_eq!(names(goal), [("table", done), ("corner", done), ("sink", done)]);
    let resets = rig
        .asked
        .iter()
        .filter(|ask| matches!(ask, Ask::Map(request) if request.action == MapAction::Reset))
        .count();
    assert_eq!(resets, 1, "what was mapped is kept");
    assert!(rig.edge.driven < 40.0, "{}", rig.edge.driven);
}
