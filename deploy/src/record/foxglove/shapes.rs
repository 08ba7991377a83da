//! Shapes. Foxglove's scenes: footprint, plan, search tree, pose graph, and what goes by itself after a while.

use foxglove::messages::line_primitive::Type as LineType;
use foxglove::messages::{
    Color, CylinderPrimitive, Duration, LinePrimitive, Point3, SceneEntity, SceneEntityDeletion, SceneUpdate, Timestamp,
};
use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{GraphEdge, GraphEdgeKind, Marker, Obstacles, Plan, PoseGraph, SearchTree};
use zenav_protocol::robot::Footprint;
use zenav_protocol::topics;

use super::{MAP, pose, pose_at, vector};
use crate::drawing::plane::{ROBOT, outline, points_of};
use crate::drawing::scene::{GOAL, PLAN, TREE};
use crate::record::format::Sample;

const ODOMETRY: [u8; 3] = [150, 150, 150];
const CLOSURE: [u8; 3] = [30, 130, 76];
const REJECTED: [u8; 3] = [215, 60, 40];
const OBSTACLE: [u8; 3] = [215, 60, 40];
const INTENT: [u8; 3] = [120, 60, 170];
const MARKER: [u8; 3] = [90, 90, 90];

/// Thickness of lines, m.
const THIN: f64 = 0.015;
/// Height of lines above the floor, m: above the map.
const LOW: f64 = 0.02;
/// Most edges of a search tree that are drawn.
const MOST_EDGES: usize = 20_000;

/// The shapes of a sample, and their topic.
pub(super) fn scene(time: Option<Timestamp>, sample: &Sample) -> Option<(String, SceneUpdate)> {
    let shapes = |frame: &str, id: &str| SceneEntity {
        timestamp: time,
        frame_id: frame.to_owned(),
        id: id.to_owned(),
        ..SceneEntity::default()
    };
    let short_lived = |id: &str| SceneEntity {
        lifetime: Some(Duration::new(1, 500_000_000)),
        ..shapes(MAP, id)
    };
    let (robot, topic, entity) = if let Some((robot, info)) = sample.reply(&topics::EDGE_INFO) {
        let mut entity = shapes(&format!("{robot}/base_link"), "footprint");
        draw_footprint(&mut entity, &info.model?.footprint);
        (robot, "footprint", entity)
    } else if let Some((robot, plan)) = sample.message(&topics::PLAN) {
        let mut entity = shapes(MAP, "plan");
        if !draw_plan(&mut entity, &plan) {
            let deletion = SceneEntityDeletion {
                timestamp: time,
                id: entity.id,
                ..SceneEntityDeletion::default()
            };
            let update = SceneUpdate {
                deletions: vec![deletion],
                entities: Vec::new(),
            };
            return Some((format!("/{robot}/plan"), update));
        }
        (robot, "plan", entity)
    } else if let Some((robot, tree)) = sample.message(&topics::TREE) {
        let mut entity = shapes(MAP, "search tree");
        draw_tree(&mut entity, &tree);
        (robot, "tree", entity)
    } else if let Some((robot, graph)) = sample.message(&topics::GRAPH) {
        let mut entity = shapes(MAP, "pose graph");
        draw_graph(&mut entity, &graph);
        (robot, "graph", entity)
    } else if let Some((robot, seen)) = sample.message(&topics::OBSTACLES) {
        let mut entity = short_lived("obstacles");
        draw_obstacles(&mut entity, &seen);
        (robot, "scene", entity)
    } else if let Some((robot, intent)) = sample.message(&topics::INTENT) {
        let mut entity = short_lived("intent");
        line(
            &mut entity,
            LineType::LineStrip,
            &intent.places,
            THIN,
            color(INTENT, 0.8),
        );
        (robot, "scene", entity)
    } else {
        let (robot, marker) = sample.message(&topics::MARKER)?;
        let mut entity = short_lived(&format!("marker {}", marker.name));
        draw_marker(&mut entity, &marker);
        (robot, "scene", entity)
    };
    let update = SceneUpdate {
        deletions: Vec::new(),
        entities: vec![entity],
    };
    Some((format!("/{robot}/{topic}"), update))
}

/// Adds a line through points of the floor, of this thickness, m.
fn line(entity: &mut SceneEntity, kind: LineType, points: &[Point2<f64>], thickness: f64, color: Option<Color>) {
    let point = |point: &Point2<f64>| Point3 {
        x: point.x,
        y: point.y,
        z: LOW,
    };
    entity.lines.push(LinePrimitive {
        r#type: kind.into(),
        pose: Some(pose(Pose2::IDENTITY)),
        thickness,
        points: points.iter().map(point).collect(),
        color,
        ..LinePrimitive::default()
    });
}

/// Adds a disc on the floor: its centre, radius and height, m.
fn disc(entity: &mut SceneEntity, at: Point2<f64>, radius: f64, height: f64, color: Option<Color>) {
    entity.cylinders.push(CylinderPrimitive {
        pose: Some(pose_at(at, 0.5 * height, 0.0)),
        size: Some(vector(Point2::new(2.0 * radius, 2.0 * radius), height)),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color,
    });
}

fn draw_footprint(entity: &mut SceneEntity, footprint: &Footprint) {
    entity.frame_locked = true;
    let corners = outline(footprint);
    line(entity, LineType::LineLoop, &corners, 2.0 * THIN, color(ROBOT, 1.0));
}

/// Draws a plan with its end; `false` if it is empty.
fn draw_plan(entity: &mut SceneEntity, plan: &Plan) -> bool {
    let points = points_of(plan);
    let Some(end) = points.last().copied() else {
        return false;
    };
    line(entity, LineType::LineStrip, &points, 2.0 * THIN, color(PLAN, 1.0));
    disc(entity, end, 0.06, LOW, color(GOAL, 0.9));
    true
}

fn draw_tree(entity: &mut SceneEntity, tree: &SearchTree) {
    let ends: Vec<Point2<f64>> = tree.edges.iter().take(MOST_EDGES).flatten().copied().collect();
    line(entity, LineType::LineList, &ends, 0.5 * THIN, color(TREE, 0.8));
    line(entity, LineType::LineStrip, &tree.path, THIN, color(ROBOT, 1.0));
}

fn draw_graph(entity: &mut SceneEntity, graph: &PoseGraph) {
    let mut draw = |rgb, is_drawn: fn(&GraphEdge) -> bool| {
        let edges = graph.lines().filter(|(edge, _)| is_drawn(edge));
        let ends: Vec<Point2<f64>> = edges.flat_map(|(_, ends)| ends).collect();
        line(entity, LineType::LineList, &ends, THIN, color(rgb, 0.8));
    };
    draw(ODOMETRY, |edge| edge.kind == GraphEdgeKind::Odometry);
    draw(CLOSURE, |edge| {
        edge.kind == GraphEdgeKind::Closure && !edge.is_rejected()
    });
    draw(REJECTED, GraphEdge::is_rejected);
}

fn draw_obstacles(entity: &mut SceneEntity, seen: &Obstacles) {
    for obstacle in &seen.obstacles {
        let at = Point2::new(obstacle.x, obstacle.y);
        let ahead = Point2::new(obstacle.x + obstacle.vx, obstacle.y + obstacle.vy);
        disc(entity, at, obstacle.radius, 0.5, color(OBSTACLE, 0.5));
        line(entity, LineType::LineStrip, &[at, ahead], THIN, color(OBSTACLE, 1.0));
    }
}

fn draw_marker(entity: &mut SceneEntity, marker: &Marker) {
    if let [point] = marker.points.as_slice() {
        disc(entity, *point, 0.04, LOW, color(MARKER, 0.9));
    } else {
        line(entity, LineType::LineStrip, &marker.points, THIN, color(MARKER, 0.9));
    }
}

fn color([r, g, b]: [u8; 3], a: f64) -> Option<Color> {
    let part = |part: u8| f64::from(part) / 255.0;
    Some(Color {
        r: part(r),
        g: part(g),
        b: part(b),
        a,
    })
}

#[cfg(test)]
mod tests {
    use foxglove::Decode as _;
    use foxglove::messages::scene_entity_deletion::Type as DeletionType;
    use foxglove::messages::{Pose, Quaternion, Vector3};
    use zenav_protocol::messages::{Event, EventKind, InfoReply, Intent, Obstacle};
    use zenav_protocol::time::Stamp;

    use super::super::{Artist, Drawn};
    use super::*;
    use crate::record::format::Kind;
    use crate::record::made_up::{self, sample};

    fn decoded(drawn: &Drawn) -> SceneUpdate {
        SceneUpdate::decode(drawn.bytes.as_slice()).unwrap()
    }

    #[test]
    fn an_obstacle_is_a_red_disc_that_goes_after_a_while() {
        let obstacle = Obstacle {
            id: 1,
            x: 1.0,
            y: 2.0,
            vx: 1.0,
            vy: 0.0,
            radius: 0.25,
            variance: [0.0; 3],
            unseen_for: 0.0,
        };
        let seen = Obstacles {
            obstacles: vec![obstacle],
            ..Obstacles::default()
        };
        let drawn = Artist::default().draw(&sample("zenav/r/edge/obstacles", &seen, 2_500_000_000));
        let red = |a: f64| {
            Some(Color {
                r: 215.0 / 255.0,
                g: 60.0 / 255.0,
                b: 40.0 / 255.0,
                a,
            })
        };
        let upright = |x: f64, y: f64, z: f64| {
            Some(Pose {
                position: Some(Vector3 { x, y, z }),
                orientation: Some(Quaternion {
                    w: 1.0,
                    ..Quaternion::default()
                }),
            })
        };
        let expected = SceneEntity {
            timestamp: Some(Timestamp::new(2, 500_000_000)),
            frame_id: "map".to_owned(),
            id: "obstacles".to_owned(),
            lifetime: Some(Duration::new(1, 500_000_000)),
            cylinders: vec![CylinderPrimitive {
                pose: upright(1.0, 2.0, 0.25),
                size: Some(Vector3 { x: 0.5, y: 0.5, z: 0.5 }),
                bottom_scale: 1.0,
                top_scale: 1.0,
                color: red(0.5),
            }],
            lines: vec![LinePrimitive {
                r#type: LineType::LineStrip.into(),
                pose: upright(0.0, 0.0, 0.0),
                thickness: 0.015,
                points: [1.0, 2.0].map(|x| Point3 { x, y: 2.0, z: 0.02 }).to_vec(),
                color: red(1.0),
                ..LinePrimitive::default()
            }],
            ..SceneEntity::default()
        };
        assert_eq!(decoded(&drawn[0]).entities, [expected]);
    }

    #[test]
    fn an_empty_plan_deletes_the_one_before() {
        let plan = made_up::plan();
        let drawn = Artist::default().draw(&sample("zenav/r/cloud/plan", &plan, 2_500_000_000));
        let deletion = SceneEntityDeletion {
            timestamp: Some(Timestamp::new(2, 500_000_000)),
            r#type: DeletionType::MatchingId.into(),
            id: "plan".to_owned(),
        };
        let expected = SceneUpdate {
            deletions: vec![deletion],
            entities: Vec::new(),
        };
        assert_eq!(decoded(&drawn[0]), expected);
    }

    #[test]
    fn every_message_of_the_table_is_drawn() {
        let mut artist = Artist::default();
        let plan = Plan {
            waypoints: vec![Point2::new(1.0, 2.0), Point2::new(2.0, 2.0)],
            ..made_up::plan()
        };
        let marker = Marker {
            stamp: Stamp(1),
            name: "waypoint".into(),
            points: vec![Point2::new(1.0, 1.0)],
        };
        let intent = Intent {
            robot: "r".into(),
            places: vec![Point2::new(0.0, 0.0)],
            ..Intent::default()
        };
        let tree = SearchTree {
            stamp: Stamp(1),
            edges: vec![[Point2::new(0.0, 0.0), Point2::new(1.0, 0.0)]],
            path: vec![Point2::new(0.0, 0.0)],
        };
        let graph = PoseGraph {
            nodes: vec![Pose2::IDENTITY, Pose2::new(1.0, 0.0, 0.0)],
            edges: vec![GraphEdge {
                from: 0,
                to: 1,
                kind: GraphEdgeKind::Closure,
                weight: 0.0,
            }],
            ..PoseGraph::default()
        };
        let event = Event {
            stamp: Stamp(1),
            boot_id: "b".into(),
            sequence: 1,
            kind: EventKind::Bumped,
        };
        let info = InfoReply {
            model: Some(zenav_fixtures::robot("tiago")),
            ..InfoReply::default()
        };
        let info = Sample {
            kind: Kind::Reply,
            ..sample("zenav/r/ask/edge/info", &info, 1)
        };
        // What stays must not share a topic: after a jump in time a viewer shows the last message of each.
        for (sample, topic) in [
            (info, "/r/footprint"),
            (sample("zenav/r/cloud/plan", &plan, 1), "/r/plan"),
            (sample("zenav/r/cloud/tree", &tree, 1), "/r/tree"),
            (sample("zenav/r/cloud/graph", &graph, 1), "/r/graph"),
            (sample("zenav/r/edge/marker", &marker, 1), "/r/scene"),
            (sample("zenav/r/edge/intent", &intent, 1), "/r/scene"),
            (sample("zenav/r/edge/obstacles", &Obstacles::default(), 1), "/r/scene"),
            (sample("zenav/r/edge/event", &event, 1), "/r/log"),
        ] {
            let drawn = artist.draw(&sample);
            let topics: Vec<&str> = drawn.iter().map(|drawn| drawn.topic.as_str()).collect();
            assert_eq!(topics, [topic], "{}", sample.key);
            if topic != "/r/log" {
                let update = decoded(&drawn[0]);
                assert_eq!(update.entities.len(), 1, "{}", sample.key);
                let is_short = update.entities[0].lifetime.is_some();
                assert_eq!(is_short, topic == "/r/scene", "{}", sample.key);
            }
        }
    }
}
