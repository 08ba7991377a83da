//! Tests of the pose graph that is published for pictures.

use zenav_protocol::messages::{GraphCertificate, GraphEdgeKind, PoseGraph};
use zenav_protocol::topics::GRAPH;

use super::*;

fn hall(way: f64) -> MappingCore {
    let mut mapping = core();
    mapping.insert(&scan(0.0), "boot");
    drive(&mut mapping, 0.0, way);
    mapping
}

#[test]
fn a_graph_is_told_when_it_has_grown_or_moved_and_in_the_frame_of_the_drawn_map() {
    let mut mapping = hall(3.0);
    let graph = mapping.untold_graph(false).unwrap();
    assert!(graph.nodes.len() > 20 && graph.boot_id == "boot", "{graph:?}");
    assert_eq!((graph.nodes[0], graph.map.frame), (Pose2::IDENTITY, 0));
    let end = graph.nodes.last().unwrap();
    assert!(end.distance(&Pose2::new(3.0, 0.0, 0.0)) < 0.15, "{end:?}");
    let is_step = |from: u32| {
        let mut edges = graph.edges.iter();
        edges.any(|edge| (edge.from, edge.to, edge.kind) == (from, from + 1, GraphEdgeKind::Odometry))
    };
    assert!((0..graph.nodes.len() as u32 - 1).all(is_step));
    assert!(graph.edges.iter().all(|edge| edge.weight == 1.0));

    // A robot at rest changes nothing.
    let standing = Scan {
        stamp: Stamp::from_secs(20.0),
        ..scan(3.0)
    };
    mapping.insert(&standing, "boot");
    assert_eq!(mapping.untold_graph(false), None);
    assert_eq!(mapping.untold_graph(true), Some(graph.clone()));

    // A moved graph waits for its map.
    mapping.bend(|pose| Pose2::new(pose.x, pose.y + 0.5, pose.yaw));
    assert_eq!(mapping.untold_graph(true), None);
    let redrawn = Scan {
        stamp: Stamp::from_secs(21.0),
        ..scan(3.0)
    };
    assert!(mapping.insert(&redrawn, "boot").frame.is_some());
    let moved = mapping.untold_graph(false).unwrap();
    assert_eq!((moved.map.frame, moved.nodes[0].y), (1, 0.5));

    mapping.reset("anew");
    let empty = mapping.untold_graph(false).unwrap();
    assert_eq!((empty.map.id.as_str(), empty.nodes.len()), ("anew", 0));
}

#[test]
fn a_solve_is_told_as_pending_and_then_as_certified() {
    let mut mapping = core();
    let mut told = Vec::new();
    // Along the hall, backwards and along it again: places are seen again.
    for step in 0..480_i32 {
        let seen = Scan {
            stamp: Stamp::from_secs(10.0 + 0.1 * f64::from(step)),
            ..scan(0.05 * f64::from(160 - (160 - step % 320).abs()))
        };
        mapping.insert(&seen, "boot");
        for work in mapping.take_ahead() {
            work.run();
        }
        told.extend(mapping.untold_graph(false).map(|graph| graph.certificate));
    }
    told.dedup();
    let expected = [
        GraphCertificate::NotSolved,
        GraphCertificate::Pending,
        GraphCertificate::Certified,
    ];
    assert!(told.starts_with(&expected), "{told:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_graph_of_a_robot_that_maps_by_slam_is_published() {
    let (router, endpoint) = router().await;
    let config = MappingConfig {
        poses: settings(),
        ..MappingConfig::new("tiago")
    };
    let client = Bus::open(BusConfig::service("client", &endpoint)).await.unwrap();
    let mut graphs = client.latest(&GRAPH, &["tiago"]).unwrap();
    let scans = client.publisher(&SCAN, &["tiago"]).unwrap();
    let states = client.publisher(&STATE, &["tiago"]).unwrap();
    let bus = Bus::open(BusConfig::service("mapping", &endpoint)).await.unwrap();
    let shutdown = Shutdown::new();
    let service = tokio::spawn(run(bus, Clock::wall(), config, shutdown.clone()));
    let mut way = 0.0;
    let graph: PoseGraph = tokio::time::timeout(DEADLINE, async {
        loop {
            way += 0.05;
            states.put(&state());
            scans.put(&scan(way));
            // The pause of a lidar at 50 Hz.
            tokio::time::sleep(Duration::from_millis(20)).await;
            if let Some(graph) = graphs.take().filter(|graph| graph.nodes.len() > 2) {
                return graph;
            }
        }
    })
    .await
    .unwrap();
    assert!(graph.lines().count() > 1, "{graph:?}");
    shutdown.trigger();
    service.await.unwrap().unwrap();
    router.close().await;
}
