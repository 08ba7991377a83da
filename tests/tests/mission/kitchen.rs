//! Claims about the kitchen mission.

use zenav_protocol::messages::{GoalPhase, GoalState, MapAction};

use super::rig::{Rig, tree};

#[test]
fn in_a_world_without_its_places_the_mission_says_which_one_it_misses() {
    let mut rig = Rig::new();
    rig.submit(tree("kitchen", "k")).unwrap();
    let reason = rig.end_of("k", 60.0).reason.unwrap();
    assert!(reason.contains("`corner`") && reason.contains("(sink)"), "{reason}");
}

fn names(goal: &GoalState) -> Vec<(&str, GoalPhase)> {
    goal.legs.iter().map(|leg| (leg.name.as_str(), leg.state)).collect()
}

#[test]
fn without_a_map_it_maps_around_the_table_then_drives_and_with_the_stored_map_it_drives_at_once() {
    let mut rig = Rig::within("kitchen");
    rig.submit(tree("kitchen", "k")).unwrap();
    let goal = rig.success_of("k", 300.0);
    let done = GoalPhase::Succeeded;
    assert_eq!(names(&goal), [("table", done), ("corner", done), ("sink", done)]);
    assert_eq!(rig.map_actions(), [MapAction::Reset, MapAction::Save]);
    assert!(rig.distance(0.88, 0.09) < 0.15, "{:?}", rig.pose());
    rig.submit(tree("kitchen", "again")).unwrap();
    let again = rig.success_of("again", 100.0);
    assert_eq!(names(&again), [("corner", done), ("sink", done)]);
    assert_eq!(rig.map_actions().len(), 2, "it is mapped once");
}

#[test]
fn a_restart_on_the_mapping_drive_keeps_the_map_and_the_place_in_the_loop() {
    let mut rig = Rig::within("kitchen");
    rig.submit(tree("kitchen", "k")).unwrap();
    rig.run(15.0);
    rig.kill();
    rig.run(10.0);
    rig.start();
    let goal = rig.success_of("k", 300.0);
    let done = GoalPhase::Succeeded;
    assert_eq!(names(&goal), [("table", done), ("corner", done), ("sink", done)]);
    assert_eq!(
        rig.map_actions(),
        [MapAction::Reset, MapAction::Resume, MapAction::Save],
        "what was mapped is kept"
    );
    assert!(rig.driven() < 40.0, "{}", rig.driven());
}
