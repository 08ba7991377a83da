//! UDP. Forwards datagrams, each client's from a port of its own, as a NAT does.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::UdpSocket;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep_until, timeout};

use super::{Impaired, UNDER_WAY, first_of};
use crate::tasks;

/// Largest datagram, bytes.
const DATAGRAM: usize = 64 * 1024;
/// A client that the server has sent nothing for this time is forgotten.
const IDLE: Duration = Duration::from_secs(120);
/// Most clients at a time.
const CLIENTS: usize = 1024;

/// A datagram, and when it arrives.
type Datagram = (Instant, Vec<u8>);

/// A client, and what forwards its datagrams both ways.
struct Client {
    to_server: mpsc::Sender<Datagram>,
    forwarding: JoinHandle<()>,
}

/// Forwards every datagram until receiving fails.
pub(super) async fn serve(socket: UdpSocket, to: &str, link: &Impaired) -> std::io::Error {
    let socket = Arc::new(socket);
    let mut clients: HashMap<SocketAddr, Client> = HashMap::new();
    let mut buffer = vec![0; DATAGRAM];
    loop {
        let (bytes, peer) = match socket.recv_from(&mut buffer).await {
            Ok(received) => received,
            // Linux tells here that a client has gone.
            Err(error) if error.kind() == std::io::ErrorKind::ConnectionRefused => continue,
            Err(error) => return error,
        };
        let Some(arrival) = link.up.datagram_arrival(bytes) else {
            continue;
        };
        clients.retain(|_, client| !client.forwarding.is_finished());
        if clients.len() >= CLIENTS && !clients.contains_key(&peer) {
            tracing::warn!(%peer, "dropped: there are {CLIENTS} clients already");
            continue;
        }
        let client = clients.entry(peer).or_insert_with(|| {
            let (to_server, under_way) = mpsc::channel(UNDER_WAY);
            let (link, to, socket) = (link.clone(), to.to_owned(), Arc::clone(&socket));
            let forwarding = tasks::spawn(async move {
                tracing::info!(%peer, "connected");
                tokio::select! {
                    () = link.reset() => tracing::info!(%peer, "forgotten"),
                    ended = forward(under_way, &to, (socket, peer), &link) => match ended {
                        Ok(()) => tracing::info!(%peer, "idle"),
                        Err(error) => tracing::warn!(%peer, to, %error, "closed"),
                    },
                }
            });
            Client { to_server, forwarding }
        });
        // A full channel loses datagrams, as any queue does.
        let _ = client
            .to_server
            .try_send((arrival, buffer.get(..bytes).unwrap_or_default().to_vec()));
    }
}

/// Forwards one client's datagrams until it is idle.
async fn forward(
    mut from_client: mpsc::Receiver<Datagram>,
    to: &str,
    (client, peer): (Arc<UdpSocket>, SocketAddr),
    link: &Impaired,
) -> std::io::Result<()> {
    let server = first_of(to, async |address: SocketAddr| {
        let any = if address.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
        let socket = UdpSocket::bind(any).await?;
        socket.connect(address).await?;
        Ok(socket)
    })
    .await?;
    let (sender, mut from_server) = mpsc::channel::<Datagram>(UNDER_WAY);
    let up = async {
        while let Some((arrival, datagram)) = from_client.recv().await {
            sleep_until(arrival).await;
            // Nobody may listen there yet: UDP does not mind.
            let _ = server.send(&datagram).await;
        }
    };
    let receiving = async {
        let mut buffer = vec![0; DATAGRAM];
        while let Ok(received) = timeout(IDLE, server.recv(&mut buffer)).await {
            let Ok(bytes) = received else { continue };
            if let Some(arrival) = link.down.datagram_arrival(bytes) {
                let _ = sender.try_send((arrival, buffer.get(..bytes).unwrap_or_default().to_vec()));
            }
        }
    };
    let down = async {
        while let Some((arrival, datagram)) = from_server.recv().await {
            sleep_until(arrival).await;
            let _ = client.send_to(&datagram, peer).await;
        }
    };
    tokio::select! {
        () = up => {}
        () = receiving => {}
        () = down => {}
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::Script;
    use super::super::link::Impairment;
    use super::*;

    #[tokio::test]
    async fn datagrams_come_and_go_late_and_each_client_has_answers_of_its_own() {
        let server = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let proxy = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let (address, to) = (proxy.local_addr().unwrap(), server.local_addr().unwrap().to_string());
        let delay = Duration::from_millis(50);
        let script = Script::from_start(Impairment {
            delay,
            ..Impairment::default()
        });
        let link = Impaired::new(&script, 0);
        let echoing = async {
            let mut buffer = [0; 16];
            loop {
                let (bytes, peer) = server.recv_from(&mut buffer).await.unwrap();
                server.send_to(&buffer[..bytes], peer).await.unwrap();
            }
        };
        let talking = async {
            let begun = Instant::now();
            let mut clients = Vec::new();
            for name in [b"a", b"b"] {
                let client = UdpSocket::bind("127.0.0.1:0").await.unwrap();
                client.connect(address).await.unwrap();
                client.send(name).await.unwrap();
                clients.push((client, name));
            }
            for (client, name) in clients {
                let mut buffer = [0; 16];
                let bytes = client.recv(&mut buffer).await.unwrap();
                assert_eq!(&buffer[..bytes], name);
            }
            assert!(begun.elapsed() >= 2 * delay, "{:?}", begun.elapsed());
        };
        tokio::select! {
            () = talking => {}
            () = echoing => {}
            error = serve(proxy, &to, &link) => panic!("{error}"),
        }
    }
}
