//! `zenav netem`: a proxy for TCP or UDP that imitates a bad link with delay, rate limit, loss, stalls and cuts; needs no root. All its
//! connections share the one link.
//!
//! | file | answers |
//! |---|---|
//! | `link` | when do bytes sent now arrive? |
//! | `script` | the text form of impairments and their changes |
//! | `tcp`, `udp` | forwarding |

mod link;
mod script;
mod tcp;
mod udp;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::net::UdpSocket;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};
use zenav_protocol::bus::interrupted;

use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::launch::runtime;
use crate::tasks;
use link::{Impairment, Link};
pub use script::Script;

/// Most pieces in flight in one direction of a connection; beyond that the sender blocks, as on a full link, and datagrams are lost.
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
    /// Address to listen on, `HOST:PORT`, `tcp/HOST:PORT`, or `quic/HOST:PORT` for links with an identity, which use UDP; port 0 takes a free
    /// one and prints it
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    listen: Address,
    /// Address to forward to, over the same protocol
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    to: Address,
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
    /// Share of the datagrams that are lost, such as 5%; TCP shows loss as stalls
    #[arg(long, value_name = "PERCENT", value_parser = script::loss)]
    loss: Option<f64>,
    /// Cut the link at this time, counted from the start; may be repeated
    #[arg(long, value_name = "TIME", value_parser = script::duration)]
    cut_at: Vec<Duration>,
    /// Length of each cut [default: for ever]
    #[arg(long, value_name = "TIME", requires = "cut_at", value_parser = script::duration)]
    cut_for: Option<Duration>,
    /// Close every connection at this time, or forget it, as a NAT does; may be repeated
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
    let protocol = args.listen.protocol;
    if args.to.protocol != protocol {
        return Err(Failure::usage("--to: expected the protocol of --listen".to_owned()));
    }
    let script = timeline(args)?;
    if protocol == Protocol::Tcp && script.loses() {
        return Err(Failure::usage(
            "loss: expected a link over UDP (`--listen quic/HOST:PORT`); TCP repeats what is lost, so imitate it with stalls".to_owned(),
        ));
    }
    let cannot_listen = |error| Failure::failed(format!("--listen {}: {error}", args.listen.host));
    tasks::block_on(&runtime()?, async {
        let link = Impaired::new(&script, args.seed);
        let to = args.to.host.as_str();
        let error = match protocol {
            Protocol::Tcp => {
                let listener = tcp::listen(&args.listen.host).await.map_err(cannot_listen)?;
                up(listener.local_addr(), "tcp", to)?;
                until_interrupted(tcp::serve(&listener, to, &link)).await
            }
            Protocol::Udp => {
                let socket = first_of(&args.listen.host, UdpSocket::bind)
                    .await
                    .map_err(cannot_listen)?;
                up(socket.local_addr(), "quic", to)?;
                until_interrupted(udp::serve(socket, to, &link)).await
            }
        };
        error.map_or(Ok(exit_code::OK), |error| Err(Failure::failed(error)))
    })
}

/// Tells where it listens.
fn up(listening: std::io::Result<SocketAddr>, protocol: &str, to: &str) -> Result<(), Failure> {
    let address = listening.map_err(Failure::failed)?;
    crate::output::line(&format!("{protocol}/{address}"));
    tracing::info!(listen = %address, to, "netem up");
    Ok(())
}

/// The error that ended it; `None` if it was interrupted.
async fn until_interrupted(serving: impl Future<Output = std::io::Error>) -> Option<std::io::Error> {
    tokio::select! {
        () = interrupted() => None,
        error = serving => Some(error),
    }
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
        loss: args.loss.unwrap_or_default(),
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

/// The link, shared by everything that is forwarded.
#[derive(Clone)]
struct Impaired {
    up: Direction,
    down: Direction,
    resets: watch::Receiver<u32>,
}

impl Impaired {
    /// The link of a script, which begins now. Call it within a runtime.
    fn new(script: &Script, seed: u64) -> Self {
        let start = Instant::now();
        let (reset, resets) = watch::channel(0_u32);
        let mut times = script.resets.clone();
        times.sort_unstable();
        tasks::spawn(async move {
            for at in times {
                sleep_until(start + at).await;
                reset.send_modify(|count| *count += 1);
            }
            // No further resets; the channel must stay open.
            reset.closed().await;
        });
        // Each direction has its own random numbers.
        let direction = |way: u64| {
            let seed = seed.wrapping_mul(1_000_003).wrapping_add(way);
            let link = Link::new(script.changes.clone(), script.cuts.clone(), seed);
            Direction {
                link: Arc::new(Mutex::new(link)),
                start,
            }
        };
        Self {
            up: direction(0),
            down: direction(1),
            resets,
        }
    }

    /// Ends with the next reset.
    async fn reset(&self) {
        let mut resets = self.resets.clone();
        resets.mark_unchanged();
        // The sender lives as long as this receiver.
        let _ = resets.changed().await;
    }
}

/// One direction of the link.
#[derive(Clone)]
struct Direction {
    link: Arc<Mutex<Link>>,
    start: Instant,
}

impl Direction {
    fn lock(&self) -> MutexGuard<'_, Link> {
        self.link.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until the queue before the link has room, which other connections take too, and returns the most bytes to read then, at most
    /// `most`.
    async fn room(&self, most: usize) -> usize {
        loop {
            let now = self.start.elapsed();
            let (full, most) = {
                let link = self.lock();
                (link.full_for(now), link.piece(now, most))
            };
            if full.is_zero() {
                return most;
            }
            tokio::time::sleep(full).await;
        }
    }

    /// When bytes sent now arrive; `None`: never.
    fn arrival(&self, bytes: usize) -> Option<Instant> {
        let arrival = self.lock().arrival(self.start.elapsed(), bytes);
        self.start.checked_add(arrival)
    }

    /// When a datagram sent now arrives; `None` if it is lost.
    fn datagram_arrival(&self, bytes: usize) -> Option<Instant> {
        let arrival = self.lock().datagram_arrival(self.start.elapsed(), bytes);
        self.start.checked_add(arrival?)
    }
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

/// What carries the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Protocol {
    Tcp,
    /// Links with an identity: QUIC.
    Udp,
}

/// A protocol and `HOST:PORT`.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Address {
    protocol: Protocol,
    host: String,
}

/// `HOST:PORT`, with or without a protocol before it.
fn address(text: &str) -> Result<Address, String> {
    let (protocol, host) = match text.split_once('/') {
        None => (Protocol::Tcp, text),
        Some(("tcp", host)) => (Protocol::Tcp, host),
        Some(("quic" | "udp", host)) => (Protocol::Udp, host),
        Some((other, _)) => return Err(format!("`{other}`: expected tcp/HOST:PORT or quic/HOST:PORT")),
    };
    let host = crate::arguments::address(host)?;
    Ok(Address { protocol, host })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_a_protocol() {
        let read = |text| address(text).map(|address| (address.protocol, address.host));
        assert_eq!(read("tcp/router:7447"), Ok((Protocol::Tcp, "router:7447".to_owned())));
        assert_eq!(read("[::1]:0"), Ok((Protocol::Tcp, "[::1]:0".to_owned())));
        assert_eq!(read("quic/router:7447"), Ok((Protocol::Udp, "router:7447".to_owned())));
        assert!(read("tls/router:7447").unwrap_err().contains("`tls`"));
        assert!(read("router").is_err());
    }
}
