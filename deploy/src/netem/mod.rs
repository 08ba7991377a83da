//! `zenav netem`: a TCP proxy that imitates a bad link with delay, rate limit, stalls and cuts; needs no root. All its connections share the
//! one link.
//!
//! | file | answers |
//! |---|---|
//! | `link` | when do bytes sent now arrive? |
//! | `script` | the text form of impairments and their changes |

mod link;
mod script;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, sleep_until};
use zenav_protocol::bus::interrupted;

use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::launch::runtime;
use crate::tasks;
use link::{Impairment, Link};
pub use script::Script;

/// Largest piece forwarded at once, bytes.
const PIECE: usize = 16 * 1024;
/// Socket buffer size, bytes; the kernel doubles it.
const BUFFER: u32 = 16 * 1024;
/// Most pieces in flight in one direction of a connection; beyond that the sender blocks, as on a full link.
const UNDER_WAY: usize = 4096;

/// Arguments of `zenav netem`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: a robot whose link to the router has a round trip of 160 ms, and is cut for 10 s after half a minute:\n  \
                  zenav router &\n  \
                  zenav netem --listen 127.0.0.1:7460 --to 127.0.0.1:7447 --delay 80ms --jitter 20ms --cut-at 30s --cut-for 10s &\n  \
                  zenav edge --connect tcp/127.0.0.1:7460"
)]
pub struct NetemArgs {
    /// Address to listen on, `HOST:PORT` or `tcp/HOST:PORT`; port 0 takes a free one and prints it
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    listen: String,
    /// Address to forward connections to
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    to: String,
    /// Delay each way
    #[arg(long, value_name = "TIME", default_value = "0ms", value_parser = script::duration)]
    delay: Duration,
    /// Largest additional delay, random for each piece
    #[arg(long, value_name = "TIME", default_value = "0ms", value_parser = script::duration)]
    jitter: Duration,
    /// Rate each way in bits per second, such as 256kbit, shared by all connections [default: unlimited]
    #[arg(long, value_name = "RATE")]
    rate: Option<String>,
    /// Length of random stalls and mean time between them, such as 500ms/10s
    #[arg(long, value_name = "TIME/TIME")]
    stall: Option<String>,
    /// Cut the link at this time, counted from the start; may be repeated
    #[arg(long, value_name = "TIME", value_parser = script::duration)]
    cut_at: Vec<Duration>,
    /// Length of each cut [default: for ever]
    #[arg(long, value_name = "TIME", requires = "cut_at", value_parser = script::duration)]
    cut_for: Option<Duration>,
    /// Close every connection at this time; may be repeated
    #[arg(long, value_name = "TIME", value_parser = script::duration)]
    reset_at: Vec<Duration>,
    /// File of further changes, one per line: `10s delay 500ms`, `20s rate 256kbit`, `30s cut 5s`, `40s reset`
    #[arg(long, value_name = "FILE")]
    script: Option<PathBuf>,
    /// Seed of jitter and stalls
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = crate::arguments::whole::<u64>)]
    seed: u64,
}

/// `zenav netem`.
///
/// # Errors
/// A taken port, a bad address, a bad line of the script.
pub fn run(args: &NetemArgs) -> Outcome {
    let script = timeline(args)?;
    tasks::block_on(&runtime()?, async {
        let listener = listen(&args.listen)
            .await
            .map_err(|error| Failure::failed(format!("--listen {}: {error}", args.listen)))?;
        let address = listener.local_addr().map_err(Failure::failed)?;
        crate::output::line(&format!("tcp/{address}"));
        tracing::info!(listen = %address, to = args.to, "netem up");
        tokio::select! {
            () = interrupted() => Ok(exit_code::OK),
            error = serve(&listener, &args.to, &script, args.seed) => Err(Failure::failed(error)),
        }
    })
}

fn timeline(args: &NetemArgs) -> Result<Script, Failure> {
    let rate = args.rate.as_deref().map(script::rate).transpose();
    let stall = args.stall.as_deref().map(script::stall).transpose();
    let named = |name: &'static str| move |error: String| Failure::usage(format!("{name} {error}"));
    let (stall, every) = stall.map_err(named("--stall"))?.unwrap_or_default();
    let mut script = Script::from_start(Impairment {
        delay: args.delay,
        jitter: args.jitter,
        rate: rate.map_err(named("--rate"))?.flatten(),
        stall,
        every,
    });
    let lasts = args.cut_for.unwrap_or(Duration::MAX);
    script
        .cuts
        .extend(args.cut_at.iter().map(|at| link::Cut { at: *at, lasts }));
    script.resets.extend(&args.reset_at);
    if let Some(path) = &args.script {
        let text = crate::files::text(path)?;
        script
            .read(&text)
            .map_err(|error| Failure::usage(format!("{}: {error}", path.display())))?;
    }
    Ok(script)
}

/// One direction of the link, shared by all connections.
#[derive(Clone)]
struct Shared(Arc<Mutex<Link>>);

impl Shared {
    fn new(link: Link) -> Self {
        Self(Arc::new(Mutex::new(link)))
    }

    fn lock(&self) -> MutexGuard<'_, Link> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until the queue before the link has room, which other connections take too, and returns the most bytes to read then.
    async fn room(&self, start: Instant) -> usize {
        loop {
            let now = start.elapsed();
            let (full, most) = {
                let link = self.lock();
                (link.full_for(now), link.piece(now, PIECE))
            };
            if full.is_zero() {
                return most;
            }
            tokio::time::sleep(full).await;
        }
    }
}

/// Forwards every connection until accepting fails.
async fn serve(listener: &TcpListener, to: &str, script: &Script, seed: u64) -> std::io::Error {
    let start = Instant::now();
    let (reset, resets) = watch::channel(0_u32);
    let times = script.resets.clone();
    let closing = tasks::spawn(async move {
        let mut times = times;
        times.sort_unstable();
        for at in times {
            sleep_until(start + at).await;
            reset.send_modify(|count| *count += 1);
        }
        // No further resets; the channel must stay open.
        reset.closed().await;
    });
    // Each direction has its own random numbers.
    let link = |way: u64| {
        let seed = seed.wrapping_mul(1_000_003).wrapping_add(way);
        Shared::new(Link::new(script.changes.clone(), script.cuts.clone(), seed))
    };
    let (up, down) = (link(0), link(1));
    let error = loop {
        let (client, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => break error,
        };
        let (up, down, to, mut resets) = (up.clone(), down.clone(), to.to_owned(), resets.clone());
        resets.mark_unchanged();
        tasks::spawn(async move {
            tracing::info!(%peer, "connected");
            tokio::select! {
                _ = resets.changed() => tracing::info!(%peer, "reset"),
                ended = connect(client, &to, up, down, start) => match ended {
                    Ok(()) => tracing::info!(%peer, "closed"),
                    Err(error) => tracing::warn!(%peer, to, %error, "closed"),
                },
            }
        });
    };
    closing.abort();
    error
}

/// Forwards one connection until both sides have closed it.
async fn connect(client: TcpStream, to: &str, up: Shared, down: Shared, start: Instant) -> std::io::Result<()> {
    let server = first_of(to, async |address| socket(address)?.connect(address).await).await?;
    client.set_nodelay(true)?;
    server.set_nodelay(true)?;
    let ((from_client, to_client), (from_server, to_server)) = (client.into_split(), server.into_split());
    tokio::try_join!(
        pass(from_client, to_server, up, start),
        pass(from_server, to_client, down, start)
    )?;
    Ok(())
}

/// Listens with small buffers, so that the link limits the data in flight, not the kernel.
async fn listen(address: &str) -> std::io::Result<TcpListener> {
    let open = async |address| {
        let socket = socket(address)?;
        socket.set_reuseaddr(true)?;
        socket.bind(address)?;
        socket.listen(1024)
    };
    first_of(address, open).await
}

/// Opens the first of a host's addresses that works; otherwise returns the last error.
async fn first_of<T>(host: &str, open: impl AsyncFn(SocketAddr) -> std::io::Result<T>) -> std::io::Result<T> {
    let mut failure = std::io::Error::other("no such host");
    for address in tokio::net::lookup_host(host).await? {
        match open(address).await {
            Ok(opened) => return Ok(opened),
            Err(error) => failure = error,
        }
    }
    Err(failure)
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
async fn pass(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, link: Shared, start: Instant) -> std::io::Result<()> {
    let (sender, mut under_way) = mpsc::channel::<(Duration, Vec<u8>)>(UNDER_WAY);
    let reading = async move {
        let mut buffer = vec![0; PIECE];
        loop {
            let most = link.room(start).await;
            let bytes = from.read(buffer.get_mut(..most).unwrap_or_default()).await?;
            let Some(piece) = buffer.get(..bytes).filter(|piece| !piece.is_empty()) else {
                return std::io::Result::Ok(());
            };
            let arrival = link.lock().arrival(start.elapsed(), bytes);
            if sender.send((arrival, piece.to_vec())).await.is_err() {
                return Ok(());
            }
        }
    };
    let writing = async move {
        while let Some((arrival, piece)) = under_way.recv().await {
            match start.checked_add(arrival) {
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

/// `HOST:PORT`, with or without `tcp/` before it.
fn address(text: &str) -> Result<String, String> {
    let address = text.strip_prefix("tcp/").unwrap_or(text);
    match address.split_once('/') {
        Some((protocol, _)) => Err(format!(
            "`{protocol}`: expected HOST:PORT or tcp/HOST:PORT, for only TCP passes here; links with an identity use UDP"
        )),
        None => crate::arguments::address(address),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_tcp_passes() {
        assert_eq!(address("tcp/router:7447"), Ok("router:7447".to_owned()));
        assert_eq!(address("[::1]:0"), Ok("[::1]:0".to_owned()));
        let refused = address("quic/router:7447").unwrap_err();
        assert!(refused.contains("`quic`") && refused.contains("UDP"), "{refused}");
        assert!(address("router").is_err());
    }

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
        let begun = Instant::now();
        let transfer = async { tokio::try_join!(send(address), send(address), receive(&server), receive(&server)) };
        let (.., first, second) = tokio::select! {
            transferred = transfer => transferred.unwrap(),
            error = serve(&proxy, &to, &script, 0) => panic!("{error}"),
        };
        assert_eq!((first, second), (SENT, SENT));
        // 32,000 bytes at 32,000 bytes a second.
        assert!(begun.elapsed() >= Duration::from_secs(1), "{:?}", begun.elapsed());
    }
}
