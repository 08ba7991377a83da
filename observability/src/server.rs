//! Health endpoint. Health and metrics over HTTP, GET only, one small bounded request per connection, so that the robot's binary needs no
//! web server.
//!
//! | path | answer |
//! |---|---|
//! | `/livez` | 200: the process answers |
//! | `/readyz` | 200 when every part is ready, else 503; a line for each condition in both |
//! | `/metrics` | Prometheus' text format |

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::time::timeout;

use crate::{metrics, readiness};

/// Most connections at once; further ones wait in the system's queue.
const MOST_CONNECTIONS: usize = 64;
/// Time limit of a request and its answer.
const WITHIN: Duration = Duration::from_secs(2);
/// Longest head of a request, bytes.
const LONGEST_HEAD: usize = 8 * 1024;
/// Most header lines.
const MOST_HEADERS: usize = 64;
/// Pause after a failed accept: the process may be short of file descriptors.
const RESPITE: Duration = Duration::from_millis(100);
/// Media type of Prometheus' text format.
const METRICS: &str = "text/plain; version=0.0.4; charset=utf-8";
/// Media type of plain text.
const TEXT: &str = "text/plain; charset=utf-8";

/// An answer.
struct Response {
    status: &'static str,
    media: &'static str,
    body: String,
}

impl Response {
    fn words(status: &'static str, body: impl Into<String>) -> Self {
        Self {
            status,
            media: TEXT,
            body: body.into(),
        }
    }
}

/// Serves at `ADDRESS:PORT` as long as the runtime runs; port 0 takes a free one. Returns the address.
///
/// # Errors
/// When the address is invalid or in use.
pub async fn serve(address: &str) -> io::Result<SocketAddr> {
    let listener = TcpListener::bind(address).await?;
    let address = listener.local_addr()?;
    tokio::spawn(take(listener));
    Ok(address)
}

async fn take(listener: TcpListener) {
    let places = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    loop {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else {
            return;
        };
        match listener.accept().await {
            Ok((stream, _)) => {
                tokio::spawn(async move {
                    // A slow or closed connection is dropped.
                    let _ = timeout(WITHIN, answer(stream)).await;
                    drop(place);
                });
            }
            Err(error) => {
                tracing::debug!(%error, "a connection to the health endpoint was not taken");
                tokio::time::sleep(RESPITE).await;
            }
        }
    }
}

/// Answers the request that arrives on a connection, and closes it.
///
/// # Errors
/// When the connection fails.
pub async fn answer(mut stream: impl AsyncRead + AsyncWrite + Unpin) -> io::Result<()> {
    let mut head = Vec::with_capacity(1024);
    let response = loop {
        let mut chunk = [0; 1024];
        let read = stream.read(&mut chunk).await?;
        if read == 0 {
            return Ok(());
        }
        head.extend_from_slice(&chunk[..read]);
        let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
        let mut request = httparse::Request::new(&mut headers);
        match request.parse(&head) {
            Ok(httparse::Status::Complete(_)) => {
                break respond(request.method.unwrap_or_default(), request.path.unwrap_or_default());
            }
            Ok(httparse::Status::Partial) if head.len() < LONGEST_HEAD => {}
            Ok(httparse::Status::Partial) => {
                break Response::words(
                    "431 Request Header Fields Too Large",
                    "the request's head is too long\n",
                );
            }
            Err(error) => break Response::words("400 Bad Request", format!("{error}\n")),
        }
    };
    let Response { status, media, body } = response;
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {media}\r\nContent-Length: {}\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
         Connection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).await?;
    stream.write_all(body.as_bytes()).await?;
    stream.shutdown().await
}

fn respond(method: &str, path: &str) -> Response {
    if method != "GET" {
        return Response::words("405 Method Not Allowed", "expected GET\n");
    }
    match path.split('?').next().unwrap_or_default() {
        "/livez" => Response::words("200 OK", "alive\n"),
        "/readyz" => match readiness::report() {
            (true, lines) => Response::words("200 OK", lines),
            (false, lines) => Response::words("503 Service Unavailable", lines),
        },
        "/metrics" => Response {
            status: "200 OK",
            media: METRICS,
            body: metrics::text(),
        },
        _ => Response::words("404 Not Found", "expected /livez, /readyz or /metrics\n"),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use tokio::net::TcpStream;

    use super::*;
    use crate::Readiness;

    async fn ask(address: SocketAddr, request: &str) -> String {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).await.unwrap();
        text
    }

    async fn get(address: SocketAddr, path: &str) -> String {
        ask(address, &format!("GET {path} HTTP/1.1\r\nHost: x\r\n\r\n")).await
    }

    #[tokio::test]
    async fn a_process_tells_that_it_lives_what_it_waits_for_and_what_it_counted() {
        let address = serve("127.0.0.1:0").await.unwrap();
        let part = Readiness::new("edge-server");
        let readings = part.expects("readings have come");
        part.started();
        assert!(get(address, "/livez").await.starts_with("HTTP/1.1 200 OK\r\n"));
        let missing = get(address, "/readyz?verbose").await;
        assert!(missing.starts_with("HTTP/1.1 503 "), "{missing}");
        assert!(
            missing.contains("missing edge-server: readings have come\n"),
            "{missing}"
        );
        readings.met();
        assert!(
            get(address, "/readyz")
                .await
                .contains("ok      edge-server: readings have come\n")
        );
        let metrics = get(address, "/metrics").await;
        assert!(
            metrics.contains("\r\nContent-Type: text/plain; version=0.0.4"),
            "{metrics}"
        );
        assert!(
            metrics.contains("zenav_part_ready{part=\"edge-server\"} 1\n"),
            "{metrics}"
        );
    }

    #[tokio::test]
    async fn what_is_no_question_is_refused_in_few_words() {
        let address = serve("127.0.0.1:0").await.unwrap();
        for (request, status) in [
            ("GET / HTTP/1.1\r\n\r\n", "404"),
            ("POST /metrics HTTP/1.1\r\n\r\n", "405"),
            ("\u{1}\r\n\r\n", "400"),
        ] {
            let answer = ask(address, request).await;
            assert!(
                answer.starts_with(&format!("HTTP/1.1 {status} ")),
                "{request:?}: {answer}"
            );
        }
        let endless = format!("GET /livez HTTP/1.1\r\nX: {}", "x".repeat(LONGEST_HEAD));
        assert!(ask(address, &endless).await.starts_with("HTTP/1.1 431 "));
    }
}
