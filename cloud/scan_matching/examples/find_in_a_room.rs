//! Finds where in a room a scan was taken, knowing only the map.
//!
//! `cargo run -p zenav-scan-matching --example find_in_a_room`

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_scan_matching::{
    FieldSettings, LikelihoodField, Pyramid, RefineSettings, VerdictSettings, Window, judge, refine, search,
};

fn main() {
    // An L-shaped room: its walls, a point every 5 cm.
    let corners = [
        (0.0, 0.0),
        (7.0, 0.0),
        (7.0, 3.0),
        (4.0, 3.0),
        (4.0, 5.0),
        (0.0, 5.0),
        (0.0, 0.0),
    ];
    let mut walls = Vec::new();
    for leg in corners.windows(2) {
        let (from, to) = (Point2::new(leg[0].0, leg[0].1), Point2::new(leg[1].0, leg[1].1));
        let count = ((to - from).norm() / 0.05) as usize;
        walls.extend((0..count).map(|step| from + (to - from) * (step as f64 / count as f64)));
    }
    let mut field = LikelihoodField::new(&FieldSettings::default());
    field.insert(Pose2::IDENTITY, &walls);

    let truth = Pose2::new(2.3, 1.7, 2.1);
    let scan: Vec<_> = walls
        .iter()
        .map(|point| truth.inverse().transform_point(*point))
        .collect();
    let window = Window {
        count: 2,
        ..Window::around(Pose2::new(3.5, 2.5, 0.0), 3.5, std::f64::consts::PI)
    };
    let pyramid = Pyramid::new(field, 6);
    let found = search(&pyramid, &scan, &window);
    let Some(best) = found.found.first() else {
        println!("nothing fits");
        return;
    };
    let refined = refine(pyramid.field(), &scan, best.pose, None, &RefineSettings::default());
    let verdict = judge(
        pyramid.field(),
        Point2::origin(),
        &scan,
        refined.pose,
        &VerdictSettings::default(),
    );
    println!("taken at  ({:.3}, {:.3}), {:.3} rad", truth.x, truth.y, truth.yaw);
    println!(
        "found at  ({:.3}, {:.3}), {:.3} rad",
        refined.pose.x, refined.pose.y, refined.pose.yaw
    );
    println!(
        "score {:.2}, better than any other place by {:.2}",
        refined.score,
        found.margin().unwrap_or(0.0)
    );
    println!(
        "explained {:.0} %, through walls {:.0} %",
        100.0 * verdict.explained,
        100.0 * verdict.through_walls
    );
    println!("{} blocks scored, exact: {}", found.scored, found.is_exact);
}
