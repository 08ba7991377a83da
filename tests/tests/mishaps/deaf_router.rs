//! A router whose Zenoh drops what another router declares: it starts anew, because messages for that router's parts would not reach them.

use std::sync::Arc;
use std::time::Duration;

use zenav_tests::deployment::Deployment;
use zenoh_protocol::core::WhatAmI;
use zenoh_protocol::network::declare::ext::NodeIdType;
use zenoh_protocol::network::declare::{Declare, DeclareBody, DeclareSubscriber};
use zenoh_protocol::network::{NetworkBody, NetworkMessage};
use zenoh_transport::{DummyTransportEventHandler, TransportManager};

use super::{LONG, ZENAV};

/// A router's place in the net that nobody has heard of.
const UNKNOWN: u16 = 4321;

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_router_that_no_longer_knows_what_another_one_subscribes_to_starts_anew_but_not_again_and_again() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let mut router = deployment.start_router();
    router.until("router up", LONG);
    declare_from_nowhere(&deployment.router).await;
    router.until("starts anew", LONG);
    assert_eq!(deployment.client(&["topic", "list"]).status.code(), Some(0));

    declare_from_nowhere(&deployment.router).await;
    assert_eq!(deployment.client(&["topic", "list"]).status.code(), Some(0));
    assert_eq!(
        router.log().matches("starts anew").count(),
        1,
        "the next time after half a minute"
    );
}

/// Links to a router as another one, and declares a subscriber in the name of a third that was never introduced.
async fn declare_from_nowhere(endpoint: &str) {
    let other = TransportManager::builder()
        .whatami(WhatAmI::Router)
        .build(Arc::new(DummyTransportEventHandler))
        .unwrap();
    let link = other.open_transport_unicast(endpoint.parse().unwrap()).await.unwrap();
    let mut declared = NetworkMessage::from(NetworkBody::Declare(Declare {
        interest_id: None,
        ext_qos: Default::default(),
        ext_tstamp: None,
        ext_nodeid: NodeIdType { node_id: UNKNOWN },
        body: DeclareBody::DeclareSubscriber(DeclareSubscriber {
            id: 1,
            wire_expr: "zenav/nowhere".into(),
        }),
    }));
    assert!(link.schedule(declared.as_mut()).unwrap());
    // Zenoh sends in the background.
    tokio::time::sleep(Duration::from_millis(500)).await;
    other.close().await;
}
