//! Test rig. Routers, sessions and a cable that can be frozen, all on free ports.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use zenav_protocol::bus::{AskError, Bus, BusConfig, RawReply, Router, RouterConfig};
use zenav_protocol::messages::{Event, EventKind, Refusal, SimClock, StopReply, StopRequest};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

/// Longer than anything here takes on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(20);

pub async fn within<F: Future>(what: &str, future: F) -> F::Output {
    tokio::time::timeout(PATIENCE, future)
        .await
        .unwrap_or_else(|_| panic!("{what} did not happen in {PATIENCE:?}"))
}

/// Repeats an attempt until it yields something.
pub async fn until<T>(what: &str, mut attempt: impl AsyncFnMut() -> Option<T>) -> T {
    let mut pace = tokio::time::interval(Duration::from_millis(10));
    within(what, async {
        loop {
            pace.tick().await;
            if let Some(found) = attempt().await {
                return found;
            }
        }
    })
    .await
}

/// A router on a free port, and its endpoint.
pub async fn router() -> (Router, String) {
    let router = Router::open(&RouterConfig {
        listen: vec!["tcp/127.0.0.1:0".into()],
        ..RouterConfig::default()
    })
    .await
    .unwrap();
    let endpoint = router.endpoints().await.remove(0);
    (router, endpoint)
}

pub async fn router_at(endpoint: &str) -> Router {
    let config = RouterConfig {
        listen: vec![endpoint.to_owned()],
        ..RouterConfig::default()
    };
    until("the port is free again", async || Router::open(&config).await.ok()).await
}

pub async fn client(endpoint: &str, name: &str) -> Bus {
    within("joining", Bus::open(BusConfig::service(name, endpoint)))
        .await
        .unwrap()
}

/// A robot that connects to the router and also listens, and its own endpoint.
pub async fn robot(endpoint: &str) -> (Bus, String) {
    let config = BusConfig {
        listen: vec!["tcp/127.0.0.1:0".into()],
        ..BusConfig::service("edge", endpoint)
    };
    let bus = within("opening", Bus::open(config)).await.unwrap();
    let own = bus.endpoints().await.remove(0);
    (bus, own)
}

/// A link to the router that can be frozen: nothing passes, and neither side is notified. It can also be pulled: all its connections end,
/// for both sides at once, and new ones are carried.
pub struct Cable {
    pub endpoint: String,
    pub frozen: watch::Sender<bool>,
    pub pulled: watch::Sender<()>,
}

impl Cable {
    pub async fn to(router: &str) -> Self {
        let target = router.strip_prefix("tcp/").unwrap().to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        let (frozen, state) = watch::channel(false);
        let (pulled, pull) = watch::channel(());
        tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let Ok(far) = TcpStream::connect(&target).await else {
                    continue;
                };
                let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
                for (mut from, mut to) in [(near_in, far_out), (far_in, near_out)] {
                    let (mut state, mut pull) = (state.clone(), pull.clone());
                    pull.mark_unchanged();
                    tokio::spawn(async move {
                        let mut buffer = vec![0; 64 * 1024];
                        loop {
                            let Ok(count @ 1..) = (tokio::select! {
                                count = from.read(&mut buffer) => count,
                                _ = pull.changed() => return,
                            }) else {
                                return;
                            };
                            if state.wait_for(|frozen| !frozen).await.is_err()
                                || to.write_all(&buffer[..count]).await.is_err()
                            {
                                return;
                            }
                        }
                    });
                }
            }
        });
        Self {
            endpoint,
            frozen,
            pulled,
        }
    }
}

pub fn event(sequence: u64) -> Event {
    Event {
        stamp: Stamp(sequence),
        boot_id: "b".into(),
        sequence,
        kind: EventKind::Started,
    }
}

pub fn clock(stamp: u64) -> SimClock {
    SimClock { stamp: Stamp(stamp) }
}

/// Answers every stop request with `stopped`.
pub fn serve_stop(bus: &Bus, robot: &str) -> tokio::task::JoinHandle<()> {
    let mut server = bus.serve(&topics::STOP, &[robot]).unwrap();
    tokio::spawn(async move {
        while let Some(request) = server.next().await {
            request.reply(&StopReply { stopped: true });
        }
    })
}

pub async fn stop(bus: &Bus, robot: &str, deadline: Duration) -> Result<StopReply, AskError> {
    bus.ask(&topics::STOP, &[robot], &StopRequest::default(), deadline)
        .await
}

pub fn refusal(reply: &RawReply) -> Refusal {
    match reply {
        RawReply::Err { bytes, encoding } => {
            assert_eq!(encoding, "application/json");
            serde_json::from_slice(bytes).unwrap()
        }
        RawReply::Ok(sample) => panic!("not refused: {sample:?}"),
    }
}
