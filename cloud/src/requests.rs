//! Requests. One queue for the requests of clients and other services to a robot's part, fed by a server for each key.

use tokio::sync::mpsc;
use tokio::task::JoinSet;
use zenav_protocol::bus::{Bus, BusError, Call};
use zenav_protocol::topics::PartAsks;

/// Requests on all keys of a part, in turn.
pub(crate) struct Requests<P: PartAsks> {
    calls: mpsc::Receiver<Call<P>>,
    /// The servers run as long as this lives.
    _servers: JoinSet<()>,
}

impl<P: PartAsks> Requests<P> {
    /// Serves all asks of a robot's part.
    pub(crate) fn open(bus: &Bus, robot: &str) -> Result<Self, BusError> {
        // Capacity one: the server that waits longest puts its request next, so none starves another.
        let (sender, calls) = mpsc::channel(1);
        let mut servers = JoinSet::new();
        for mut server in bus.serve_part::<P>(&[robot])? {
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

    /// The next request, with the channel for its answer; `None` when the bus was closed. Loses nothing if it is dropped.
    pub(crate) async fn next(&mut self) -> Option<Call<P>> {
        self.calls.recv().await
    }
}
