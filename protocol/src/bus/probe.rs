//! Probe. Does a router answer at an endpoint, however late?

use std::time::Duration;

use tokio::net::{TcpStream, UdpSocket, lookup_host};
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// Longest time to wait for an answer: the longest round trip that a mission is promised, and some jitter.
const LATEST: Duration = Duration::from_millis(5500);
/// Pause between two packets to an endpoint that does not answer: some may be lost.
const AGAIN: Duration = Duration::from_secs(1);
/// Size of the first packet of a QUIC connection, bytes (RFC 9000, section 14.1); a server ignores a smaller one.
const FIRST_PACKET: usize = 1200;
/// A version of QUIC that no server speaks (RFC 9000, section 15), so that it answers with those that it does, and keeps no state.
const NO_VERSION: [u8; 4] = [0x1a, 0x2a, 0x3a, 0x4a];
/// Connection id of the client, by which it knows the answer.
const ID: [u8; 8] = *b"zenav-ok";

/// A probe under way.
#[derive(Debug)]
pub(super) struct Probing(Option<JoinHandle<bool>>);

impl Probing {
    /// Begins to probe these endpoints after a time, if `is_wanted`.
    pub(super) fn begin(endpoints: &[String], is_wanted: bool, after: Duration) -> Self {
        let endpoints = endpoints.to_vec();
        let probing = async move {
            tokio::time::sleep(after).await;
            answers(&endpoints).await
        };
        Self(is_wanted.then(|| tokio::spawn(probing)))
    }

    /// Waits for its end: whether a router has answered. Once only.
    pub(super) async fn has_answer(&mut self) -> bool {
        match self.0.take() {
            Some(probing) => probing.await.unwrap_or(false),
            None => false,
        }
    }
}

impl Drop for Probing {
    fn drop(&mut self) {
        if let Some(probing) = &self.0 {
            probing.abort();
        }
    }
}

/// Whether somebody accepts TCP connections, or speaks QUIC, at one of these endpoints.
async fn answers(endpoints: &[String]) -> bool {
    for endpoint in endpoints {
        let (protocol, address) = endpoint.split_once('/').unwrap_or(("tcp", endpoint));
        let address = address.split(['?', '#']).next().unwrap_or_default();
        let probing = async {
            match protocol {
                "quic" => speaks_quic(address).await,
                _ => TcpStream::connect(address).await.map(|_| ()),
            }
        };
        if matches!(timeout(LATEST, probing).await, Ok(Ok(()))) {
            return true;
        }
    }
    false
}

/// Waits until a QUIC server at this address answers (version negotiation, RFC 9000, section 6).
async fn speaks_quic(address: &str) -> std::io::Result<()> {
    let to = lookup_host(address).await?.next().ok_or(std::io::ErrorKind::NotFound)?;
    let socket = UdpSocket::bind(if to.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" }).await?;
    socket.connect(to).await?;
    let mut first = vec![0xc0];
    first.extend(NO_VERSION);
    for id in [b"anywhere", &ID] {
        first.push(8);
        first.extend(id);
    }
    first.resize(FIRST_PACKET, 0);
    let mut answer = [0; FIRST_PACKET];
    let mut again = tokio::time::interval(AGAIN);
    loop {
        let bytes = tokio::select! {
            _ = again.tick() => {
                socket.send(&first).await?;
                continue;
            }
            bytes = socket.recv(&mut answer) => bytes?,
        };
        let is_long_header = answer[0] & 0x80 != 0;
        let names_client = answer.get(5..14).is_some_and(|id| id[0] == 8 && id[1..] == ID);
        if bytes >= 14 && is_long_header && answer[1..5] == [0; 4] && names_client {
            return Ok(());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_listener_answers_and_a_free_port_does_not() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let taken = format!("tcp/{}", listener.local_addr().unwrap());
        assert!(answers(std::slice::from_ref(&taken)).await);
        drop(listener);
        assert!(!answers(&[taken]).await);
        let free = UdpSocket::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
        assert!(!answers(&[format!("quic/{free}")]).await, "refused by the system");
    }
}
