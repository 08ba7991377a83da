//! Requests. One queue for the requests of clients and other missions, fed by a server for each key.

use tokio::sync::mpsc;
use tokio::task::JoinSet;
use zenav_protocol::bus::{Bus, BusError, Call};
use zenav_protocol::topics::MissionRequest;

/// A client's request, with the channel for its answer.
pub(super) type Pending = Call<MissionRequest>;

/// Requests on all keys, in turn.
pub(super) struct Requests {
    calls: mpsc::Receiver<Pending>,
    /// The servers run as long as this lives.
    _servers: JoinSet<()>,
}

impl Requests {
    /// Serves the mission requests of a robot.
    pub(super) fn open(bus: &Bus, robot: &str) -> Result<Self, BusError> {
        // Capacity one: the server that waits longest puts its request next, so none starves another.
        let (sender, calls) = mpsc::channel(1);
        let mut servers = JoinSet::new();
        for mut server in bus.serve_part(&[robot])? {
            let sender = sender.clone();
            servers.spawn(async move {
                while let Some(call) = server.next().await {
                    if sender.send(call).await.is_err() {
                        return;
                    }
                }
            });
        }
        Ok(Self {
            calls,
            _servers: servers,
        })
    }

    /// The next request; `None` when the bus was closed.
    pub(super) async fn next(&mut self) -> Option<Pending> {
        self.calls.recv().await
    }
}
