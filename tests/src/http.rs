//! HTTP. A minimal HTTP client, one request per connection, so that tests see exactly what a part sends.

#![allow(clippy::expect_used, reason = "a test cannot go on without its answer")]

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::Duration;

use serde_json::Value;

/// Longest wait for an answer.
const LONG: Duration = Duration::from_secs(60);

/// An answer.
#[derive(Debug)]
pub struct Answer {
    /// Its status.
    pub status: u16,
    /// Status line and headers, in lower case.
    pub head: String,
    /// Its body.
    pub body: Vec<u8>,
}

impl Answer {
    /// The body as JSON.
    ///
    /// # Panics
    /// When the body is not JSON.
    #[must_use]
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).expect("the body is JSON")
    }

    /// The body as text.
    #[must_use]
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

/// One request to `ADDRESS:PORT`; the body ends with the connection.
///
/// # Panics
/// Without an answer.
#[must_use]
pub fn request(address: &str, method: &str, path: &str, host: &str) -> Answer {
    send(address, method, path, &[("Host", host)])
}

/// A `GET` with a bearer token.
///
/// # Panics
/// Without an answer.
#[must_use]
pub fn get_with_token(address: &str, path: &str, token: &str) -> Answer {
    let bearer = format!("Bearer {token}");
    send(
        address,
        "GET",
        path,
        &[("Host", address), ("Authorization", bearer.as_str())],
    )
}

fn send(address: &str, method: &str, path: &str, headers: &[(&str, &str)]) -> Answer {
    let headers: String = headers
        .iter()
        .map(|(name, value)| format!("{name}: {value}\r\n"))
        .collect();
    let ask = || -> std::io::Result<Vec<u8>> {
        let mut link = TcpStream::connect(address)?;
        link.set_read_timeout(Some(LONG))?;
        write!(link, "{method} {path} HTTP/1.1\r\n{headers}Connection: close\r\n\r\n")?;
        let mut bytes = Vec::new();
        link.read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    let bytes = ask().unwrap_or_else(|error| panic!("{method} {address}{path}: {error}"));
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").expect("a head");
    let head = String::from_utf8_lossy(&bytes[..end]).to_lowercase();
    Answer {
        status: head
            .split(' ')
            .nth(1)
            .and_then(|status| status.parse().ok())
            .expect("a status"),
        head,
        body: bytes[end + 4..].to_vec(),
    }
}
