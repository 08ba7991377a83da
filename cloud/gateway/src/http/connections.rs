//! Connections. How many may be open at once, and how long may a request take to arrive? Idle and very slow clients must not keep others
//! out.

use std::future::Future;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};

/// Pause after a connection could not be accepted, s: the process may be out of file descriptors.
const PAUSE: Duration = Duration::from_secs(1);
/// Longest wait at the end for answers in progress, s.
const ENDING: Duration = Duration::from_secs(5);

/// Limits of connections.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Most connections open at once; later ones wait in the kernel's queue. A WebSocket counts as a browser instead.
    pub(super) most: u32,
    /// Time from an answer, or from the start of the connection, to the last header of the next request.
    pub(super) head_within: Duration,
}

/// Serves connections until `ended`; then closes open connections.
pub(super) async fn serve(
    listener: TcpListener,
    router: Router,
    limits: Limits,
    ended: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    let room = Arc::new(Semaphore::new(limits.most as usize));
    let (ending, _) = watch::channel(false);
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(limits.head_within);
    let accept = async {
        loop {
            let Ok(permit) = Arc::clone(&room).acquire_owned().await else {
                return;
            };
            let stream = match listener.accept().await {
                Ok((stream, _)) => stream,
                Err(error) if is_of_one(&error) => continue,
                Err(error) => {
                    tracing::warn!(%error, "a connection cannot be accepted");
                    tokio::time::sleep(PAUSE).await;
                    continue;
                }
            };
            let service = TowerToHyperService::new(router.clone());
            let connection = http.serve_connection(TokioIo::new(stream), service).with_upgrades();
            let mut end = ending.subscribe();
            tokio::spawn(async move {
                let mut connection = pin!(connection);
                // A client that disconnects is not an error of this side.
                tokio::select! {
                    _ = connection.as_mut() => {}
                    _ = end.changed() => {
                        connection.as_mut().graceful_shutdown();
                        let _ = connection.await;
                    }
                }
                drop(permit);
            });
        }
    };
    tokio::select! {
        () = accept => {}
        () = ended => {}
    }
    ending.send_replace(true);
    let _ = tokio::time::timeout(ENDING, room.acquire_many(limits.most)).await;
    Ok(())
}

/// Whether an error concerns a single connection: its client disconnected before it was accepted.
fn is_of_one(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::net::TcpStream;

    use super::*;

    #[tokio::test]
    async fn who_connects_and_says_nothing_keeps_nobody_out() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let router = Router::new().route("/", axum::routing::get(|| async { "here" }));
        let limits = Limits {
            most: 1,
            head_within: Duration::from_millis(50),
        };
        let (end, ended) = tokio::sync::oneshot::channel::<()>();
        let served = tokio::spawn(serve(listener, router, limits, async { drop(ended.await) }));

        let mut silent = TcpStream::connect(address).await.unwrap();
        let mut client = TcpStream::connect(address).await.unwrap();
        client
            .write_all(b"GET / HTTP/1.1\r\nhost: robots\r\nconnection: close\r\n\r\n")
            .await
            .unwrap();
        let (mut answer, mut rest) = (String::new(), Vec::new());
        client.read_to_string(&mut answer).await.unwrap();
        assert!(
            answer.starts_with("HTTP/1.1 200") && answer.ends_with("here"),
            "{answer}"
        );
        let said = silent.read_to_end(&mut rest).await.unwrap_or_default();
        assert!(said == 0 || rest.starts_with(b"HTTP/1.1 408"), "it was closed");
        drop(end);
        served.await.unwrap().unwrap();
    }
}
