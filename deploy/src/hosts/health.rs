//! Health of a part on this machine. The readiness check of a container engine, done by the binary itself: its image has no shell.

use std::io::{Error, ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use crate::exit_code;
use crate::failure::Failure;

/// Longest wait for a connection, and for each piece of the answer.
const PATIENCE: Duration = Duration::from_secs(2);
/// Most bytes read of an answer.
const MOST: u64 = 4096;

/// Asks `GET /readyz`; returns the answer's text.
///
/// # Errors
/// Exit code 4 if nothing listens, 5 without an answer in time, 1 if the part is not ready or another program listens.
pub(super) fn ready(address: SocketAddr) -> Result<String, Failure> {
    let failed = |error: Error| {
        let code = match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut => exit_code::TIMEOUT,
            _ => exit_code::FAILED,
        };
        Failure::new(code, format!("{address}: {error}"))
    };
    let mut stream = TcpStream::connect_timeout(&address, PATIENCE)
        .map_err(|error| Failure::cannot_connect(format!("cannot connect to {address}: {error}")))?;
    stream.set_read_timeout(Some(PATIENCE)).map_err(failed)?;
    stream.set_write_timeout(Some(PATIENCE)).map_err(failed)?;
    let request = format!("GET /readyz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).map_err(failed)?;
    let mut answer = Vec::new();
    stream.take(MOST).read_to_end(&mut answer).map_err(failed)?;
    let answer = String::from_utf8_lossy(&answer);
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    let mut words = head.split(' ');
    match (words.next(), words.next()) {
        (Some("HTTP/1.1" | "HTTP/1.0"), Some("200")) => Ok(body.trim().to_owned()),
        _ => {
            let first = head.lines().next().unwrap_or_default();
            Err(Failure::failed(format!("{address}: {first}: {}", body.trim())))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead as _, BufReader};
    use std::net::TcpListener;

    use super::*;

    fn answering(answer: &'static str) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut request = String::new();
            BufReader::new(stream.try_clone().unwrap())
                .read_line(&mut request)
                .unwrap();
            assert_eq!(request, "GET /readyz HTTP/1.1\r\n");
            stream.write_all(answer.as_bytes()).unwrap();
        });
        address
    }

    #[test]
    fn a_part_is_ready_when_it_says_so_and_only_then() {
        let yes = answering("HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nok");
        assert_eq!(ready(yes).unwrap(), "ok");
        let no = answering("HTTP/1.1 503 Service Unavailable\r\n\r\nno router");
        let failure = ready(no).unwrap_err();
        assert_eq!(failure.code, exit_code::FAILED);
        assert!(
            failure.message.contains("503") && failure.message.contains("no router"),
            "{failure}"
        );
        assert_eq!(ready(answering("SSH-2.0\r\n")).unwrap_err().code, exit_code::FAILED);
    }

    #[test]
    fn who_does_not_listen_and_who_does_not_answer_are_told_apart() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        assert_eq!(ready(address).unwrap_err().code, exit_code::TIMEOUT);
        drop(listener);
        assert_eq!(ready(address).unwrap_err().code, exit_code::CANNOT_CONNECT);
    }
}
