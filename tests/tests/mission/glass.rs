//! Obstacles that no beam shows: the robot learns of them by touch.

use zenav_protocol::messages::GoalPhase;

use super::rig::{Rig, to};

/// A room from (0, 0) to (9, 6) with a pane of glass across the way from (1, 3) to (7, 3), and 2 m of floor beside either end of it.
const ROOM: &str = "size = [9.4, 6.4]\norigin = [-0.2, -0.2]\n[start]\nx = 1\ny = 3\n\
    [[wall]]\nfrom = [-0.1, -0.1]\nto = [9.1, -0.1]\nthickness = 0.2\n\
    [[wall]]\nfrom = [-0.1, 6.1]\nto = [9.1, 6.1]\nthickness = 0.2\n\
    [[wall]]\nfrom = [-0.1, -0.1]\nto = [-0.1, 6.1]\nthickness = 0.2\n\
    [[wall]]\nfrom = [9.1, -0.1]\nto = [9.1, 6.1]\nthickness = 0.2\n\
    [[wall]]\nfrom = [4, 2]\nto = [4, 4]\nthickness = 0.02\nglass = true\n";

#[test]
fn glass_in_the_way_is_touched_twice_at_most_and_driven_round() {
    let mut rig = Rig::in_world(ROOM);
    rig.submit(to(7.0, 3.0, "a")).unwrap();
    let goal = rig.end_of("a", 120.0);
    assert_eq!(goal.state, GoalPhase::Succeeded, "{goal:#?}\n{:?}", rig.events);
    let touched = rig.truth().collisions;
    assert!((1..=2).contains(&touched), "{touched} contacts: {:?}", rig.events);
    // The map knows the places that were touched. The rest was only assumed and may be forgotten by now: the way back may show one more.
    rig.submit(to(1.0, 3.0, "b")).unwrap();
    let goal = rig.end_of("b", 120.0);
    assert_eq!(goal.state, GoalPhase::Succeeded, "{goal:#?}\n{:?}", rig.events);
    let since = rig.truth().collisions - touched;
    assert!(since <= 1, "{since} more contacts: {:?}", rig.events);
}

/// A corridor along the x axis, 5 m wide, with a pane of glass in the door at its end, (8, 2.5). The way round leads through an opening at
/// its other end, (-7.8, 5), and back along another corridor.
const DOOR: &str = "size = [21.4, 8.4]\norigin = [-9.2, -0.2]\n[start]\nx = 3\ny = 2.5\n\
    [[wall]]\nfrom = [-9.1, -0.1]\nto = [12.1, -0.1]\nthickness = 0.2\n\
    [[wall]]\nfrom = [-9.1, 8.1]\nto = [12.1, 8.1]\nthickness = 0.2\n\
    [[wall]]\nfrom = [-9.1, -0.1]\nto = [-9.1, 8.1]\nthickness = 0.2\n\
    [[wall]]\nfrom = [12.1, -0.1]\nto = [12.1, 8.1]\nthickness = 0.2\n\
    [[polygon]]\npoints = [[7.9, 0], [8.1, 0], [8.1, 2.05], [7.9, 2.05]]\n\
    [[polygon]]\npoints = [[7.9, 2.95], [8.1, 2.95], [8.1, 5.1], [7.9, 5.1]]\n\
    [[polygon]]\npoints = [[-6.5, 4.9], [8.1, 4.9], [8.1, 5.1], [-6.5, 5.1]]\n\
    [[wall]]\nfrom = [8, 2.05]\nto = [8, 2.95]\nthickness = 0.02\nglass = true\n";

#[test]
fn glass_that_shuts_the_short_way_is_not_waited_for() {
    let mut rig = Rig::in_world(DOOR);
    rig.submit(to(10.0, 2.5, "a")).unwrap();
    assert!(
        rig.run_until(40.0, |rig| rig.truth().collisions > 0),
        "{:?}",
        rig.goal("a")
    );
    // The way round costs more than a minute, which the robot would wait for somebody whom it saw come.
    let driven = rig.driven();
    let goes = rig.run_until(25.0, |rig| rig.driven() > driven + 2.0);
    assert!(goes, "{:?} {:?}", rig.pose(), rig.goal("a").feedback);
    let goal = rig.end_of("a", 200.0);
    assert_eq!(goal.state, GoalPhase::Succeeded, "{goal:#?}\n{:?}", rig.events);
}
