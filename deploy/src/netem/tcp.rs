//! TCP. Forwards connections.

use std::net::SocketAddr;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::mpsc;
use tokio::time::sleep_until;

use super::{Direction, Impaired, UNDER_WAY, first_of};
use crate::tasks;

/// Largest piece forwarded at once, bytes.
const PIECE: usize = 16 * 1024;
/// Socket buffer size, bytes; the kernel doubles it.
const BUFFER: u32 = 16 * 1024;

/// Forwards every connection until accepting fails.
pub(super) async fn serve(listener: &TcpListener, to: &str, link: &Impaired) -> std::io::Error {
    loop {
        let (client, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => return error,
        };
        let (link, to) = (link.clone(), to.to_owned());
        tasks::spawn(async move {
            tracing::info!(%peer, "connected");
            tokio::select! {
                () = link.reset() => tracing::info!(%peer, "reset"),
                ended = connect(client, &to, &link) => match ended {
                    Ok(()) => tracing::info!(%peer, "closed"),
                    Err(error) => tracing::warn!(%peer, to, %error, "closed"),
                },
            }
        });
    }
}

/// Forwards one connection until both sides have closed it.
async fn connect(client: TcpStream, to: &str, link: &Impaired) -> std::io::Result<()> {
    let server = first_of(to, async |address| socket(address)?.connect(address).await).await?;
    client.set_nodelay(true)?;
    server.set_nodelay(true)?;
    let ((from_client, to_client), (from_server, to_server)) = (client.into_split(), server.into_split());
    tokio::try_join!(
        pass(from_client, to_server, link.up.clone()),
        pass(from_server, to_client, link.down.clone())
    )?;
    Ok(())
}

/// Listens with small buffers, so that the link limits the data in flight, not the kernel.
pub(super) async fn listen(address: &str) -> std::io::Result<TcpListener> {
    let open = async |address| {
        let socket = socket(address)?;
        socket.set_reuseaddr(true)?;
        socket.bind(address)?;
        socket.listen(1024)
    };
    first_of(address, open).await
}

fn socket(address: SocketAddr) -> std::io::Result<TcpSocket> {
    let socket = if address.is_ipv4() {
        TcpSocket::new_v4()?
    } else {
        TcpSocket::new_v6()?
    };
    socket.set_recv_buffer_size(BUFFER)?;
    Ok(socket)
}

/// One direction of a connection.
async fn pass(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, link: Direction) -> std::io::Result<()> {
    let (sender, mut under_way) = mpsc::channel(UNDER_WAY);
    let reading = async move {
        let mut buffer = vec![0; PIECE];
        loop {
            let most = link.room(PIECE).await;
            let bytes = from.read(buffer.get_mut(..most).unwrap_or_default()).await?;
            let Some(piece) = buffer.get(..bytes).filter(|piece| !piece.is_empty()) else {
                return std::io::Result::Ok(());
            };
            if sender.send((link.arrival(bytes), piece.to_vec())).await.is_err() {
                return Ok(());
            }
        }
    };
    let writing = async move {
        while let Some((arrival, piece)) = under_way.recv().await {
            match arrival {
                Some(at) => sleep_until(at).await,
                // Cut for ever.
                None => std::future::pending().await,
            }
            to.write_all(&piece).await?;
        }
        to.shutdown().await
    };
    tokio::try_join!(reading, writing)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::time::Instant;

    use super::super::Script;
    use super::super::link::Impairment;
    use super::*;

    /// Bytes that each connection sends.
    const SENT: usize = 16_000;

    /// Sends over one connection; returns once the last byte has left.
    async fn send(address: SocketAddr) -> std::io::Result<()> {
        let mut stream = TcpStream::connect(address).await?;
        stream.write_all(&[7; SENT]).await?;
        stream.shutdown().await
    }

    /// Receives what one connection sends.
    async fn receive(listener: &TcpListener) -> std::io::Result<usize> {
        let (mut stream, _) = listener.accept().await?;
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).await
    }

    #[tokio::test]
    async fn two_connections_share_the_rate_of_one_link() {
        let (proxy, server) = (
            listen("127.0.0.1:0").await.unwrap(),
            listen("127.0.0.1:0").await.unwrap(),
        );
        let (address, to) = (proxy.local_addr().unwrap(), server.local_addr().unwrap().to_string());
        let script = Script::from_start(Impairment {
            rate: Some(32_000.0),
            ..Impairment::default()
        });
        let link = Impaired::new(&script, 0);
        let begun = Instant::now();
        let transfer = async { tokio::try_join!(send(address), send(address), receive(&server), receive(&server)) };
        let (.., first, second) = tokio::select! {
            transferred = transfer => transferred.unwrap(),
            error = serve(&proxy, &to, &link) => panic!("{error}"),
        };
        assert_eq!((first, second), (SENT, SENT));
        // 32,000 bytes at 32,000 bytes a second.
        assert!(begun.elapsed() >= Duration::from_secs(1), "{:?}", begun.elapsed());
    }
}
