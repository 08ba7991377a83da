//! Does the edge keep its promises over the bus, with no router and no cloud, and across restarts?
#![cfg(feature = "sim")]
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::path::Path;
use std::time::Duration;

use zenav_edge::{EdgeConfig, EdgeError, Referee, ServiceConfig, SimBody};
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::bus::{AskError, Bus, BusConfig, Shutdown};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    EdgeState, InfoRequest, LeaseAction, LeaseRequest, LeaseRole, Mode, ParamRequest, Refusal, ResumeRequest,
    StopRequest, Teleop,
};
use zenav_protocol::topics;
use zenav_sim::{RobotSpec, Simulation, World};

const DEADLINE: Duration = Duration::from_secs(20);
const ROBOT: &[&str] = &["tiago"];

/// An edge of its own, on a free port and with no router, and an operator's bus to it.
struct Edge {
    operator: Bus,
    referee: Referee,
    shutdown: Shutdown,
    running: tokio::task::JoinHandle<Result<(), EdgeError>>,
}

/// A robot in the kitchen, whose time passes at this rate.
fn simulated(state_dir: &Path, speed: f64) -> (ServiceConfig, SimBody, Referee) {
    let world = World::shipped("kitchen").unwrap();
    let model = zenav_fixtures::robot("tiago");
    let id = Id::robot("tiago").unwrap();
    let spec = RobotSpec {
        id: id.clone(),
        model: model.clone(),
        start: world.start(),
    };
    let (body, referee) = SimBody::all(Simulation::new(&world, vec![spec], 1).unwrap()).remove(0);
    let config = ServiceConfig {
        edge: EdgeConfig::new(id, model, world.start()),
        state_dir: state_dir.to_owned(),
        speed,
        gives_the_time: true,
    };
    (config, body, referee)
}

/// The bus of an edge without a router.
async fn own_bus() -> Bus {
    let listen = BusConfig {
        connect: Vec::new(),
        listen: vec!["tcp/127.0.0.1:0".into()],
        name: "edge".into(),
        ..BusConfig::default()
    };
    Bus::open(listen).await.unwrap()
}

impl Edge {
    async fn start(state_dir: &Path) -> Self {
        let (config, body, referee) = simulated(state_dir, 2.0);
        let bus = own_bus().await;
        let endpoint = bus
            .endpoints()
            .await
            .into_iter()
            .find(|endpoint| endpoint.contains("127.0.0.1"))
            .unwrap();
        let shutdown = Shutdown::new();
        let running = tokio::spawn({
            let shutdown = shutdown.clone();
            async move {
                let result = zenav_edge::run(bus.clone(), config, Box::new(body), shutdown).await;
                bus.close().await;
                result
            }
        });
        let operator = Bus::open(BusConfig::command("operator", &endpoint)).await.unwrap();
        Self {
            operator,
            referee,
            shutdown,
            running,
        }
    }

    async fn end(self) {
        self.shutdown.trigger();
        tokio::time::timeout(DEADLINE, self.running)
            .await
            .unwrap()
            .unwrap()
            .unwrap();
        let twist = self.referee.truth().twist;
        assert!(
            twist.v.abs() < 0.02 && twist.w.abs() < 0.05,
            "the robot is stopped first: {twist:?}"
        );
        self.operator.close().await;
    }

    /// The first state for which the claim holds.
    async fn state(&self, claim: impl Fn(&EdgeState) -> bool) -> EdgeState {
        let mut states = self.operator.latest(&topics::STATE, ROBOT).unwrap();
        let wait = async {
            loop {
                let state = states.next().await.unwrap().message;
                if claim(&state) {
                    return state;
                }
            }
        };
        tokio::time::timeout(DEADLINE, wait).await.unwrap()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_reaches_the_robot_with_no_router_and_outlives_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let edge = Edge::start(folder.path()).await;
    let info = edge
        .operator
        .ask(&topics::EDGE_INFO, ROBOT, &InfoRequest {}, DEADLINE)
        .await
        .unwrap();
    assert_eq!((info.component.as_str(), info.schema), ("edge", SCHEMA_VERSION));
    assert_eq!(info.model.unwrap().name, "tiago");
    let first_boot = info.boot.unwrap().boot_id;
    let take = LeaseRequest::new("me", LeaseRole::Operator, LeaseAction::Acquire, "r1");
    let lease = edge.operator.ask(&topics::LEASE, ROBOT, &take, DEADLINE).await.unwrap();
    assert_eq!(lease.epoch, 1);
    let stop = StopRequest::new("me");
    assert!(
        edge.operator
            .ask(&topics::STOP, ROBOT, &stop, DEADLINE)
            .await
            .unwrap()
            .stopped
    );
    edge.end().await;

    let edge = Edge::start(folder.path()).await;
    let state = edge.state(|_| true).await;
    assert_eq!(state.mode, Mode::Stopped);
    assert_ne!(state.boot_id, first_boot);
    let again = LeaseRequest {
        request_id: "r2".into(),
        ..take
    };
    assert_eq!(
        edge.operator
            .ask(&topics::LEASE, ROBOT, &again, DEADLINE)
            .await
            .unwrap()
            .epoch,
        2
    );
    assert!(
        !edge
            .operator
            .ask(&topics::RESUME, ROBOT, &ResumeRequest::default(), DEADLINE)
            .await
            .unwrap()
            .stopped
    );
    edge.state(|state| state.mode != Mode::Stopped).await;
    edge.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_operator_drives_by_hand_and_a_change_without_the_epoch_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let edge = Edge::start(folder.path()).await;
    let take = LeaseRequest::new("me", LeaseRole::Operator, LeaseAction::Acquire, "r1");
    let epoch = edge
        .operator
        .ask(&topics::LEASE, ROBOT, &take, DEADLINE)
        .await
        .unwrap()
        .epoch;
    let teleop = edge.operator.publisher(&topics::TELEOP, ROBOT).unwrap();
    let mut states = edge.operator.latest(&topics::STATE, ROBOT).unwrap();
    let drive = async {
        loop {
            let state = states.next().await.unwrap().message;
            teleop.put(&Teleop {
                epoch,
                twist: Twist2::new(0.0, 0.8),
                echo: state.stamp,
            });
            if state.velocity.w > 0.6 {
                return;
            }
        }
    };
    tokio::time::timeout(DEADLINE, drive).await.unwrap();
    // Silence: the dead-man's switch.
    edge.state(|state| state.velocity.w.abs() < 0.02).await;
    let change = ParamRequest {
        name: Some("heading_gain".into()),
        value: Some(3.0),
        epoch: Some(epoch + 1),
    };
    let refused = edge.operator.ask(&topics::PARAM, ROBOT, &change, DEADLINE).await;
    assert!(
        matches!(refused, Err(AskError::Refused(Refusal::WrongEpoch { .. }))),
        "{refused:?}"
    );
    edge.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_speed_at_which_a_control_period_would_never_end_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for speed in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-6, 1e-310] {
        let (config, body, _) = simulated(folder.path(), speed);
        let bus = own_bus().await;
        let refused = zenav_edge::run(bus.clone(), config, Box::new(body), Shutdown::new()).await;
        bus.close().await;
        assert!(matches!(refused, Err(EdgeError::Speed(_))), "{speed}: {refused:?}");
    }
}
