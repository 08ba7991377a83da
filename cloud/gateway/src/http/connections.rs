//! Connections. How many may be open at once, and how long may a request take to arrive? Idle and very slow clients must not keep others
//! out: a stop must get through.

use std::collections::BTreeMap;
use std::future::Future;
use std::io::IoSlice;
use std::pin::{Pin, pin};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use hyper::body::Incoming;
use hyper::rt::{Read, ReadBufCursor, Write};
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Notify, Semaphore, watch};
use tokio::time::{Instant, Sleep, sleep, timeout};

/// Pause after a connection could not be accepted, s: the process may be out of file descriptors.
const PAUSE: Duration = Duration::from_secs(1);
/// Longest wait at the end for answers in progress, s.
const ENDING: Duration = Duration::from_secs(5);
/// Time after an answer in which its last bytes may still be on their way, s: a connection that makes room sooner is not cut off at once.
const ANSWERING: Duration = Duration::from_secs(1);

/// Limits of connections.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Most connections open at once. For a further one, the one that has waited longest for a request is closed; without such a one, it
    /// waits. A WebSocket counts as a browser instead.
    pub(super) most: u32,
    /// Time from an answer, or from the start of the connection, to the last header of the next request.
    pub(super) head_within: Duration,
    /// Time in which a client must take an answer that the network does not take at once; after that, it counts as one that waits.
    pub(super) answer_within: Duration,
}

/// Connections that wait for a request, in the order in which they began to.
#[derive(Debug, Default)]
struct Waiting {
    turns: u64,
    by_turn: BTreeMap<u64, Arc<Notify>>,
    /// Whether the next one that begins to wait must close instead.
    wanted: bool,
}

impl Waiting {
    fn lock(waiting: &Mutex<Self>) -> MutexGuard<'_, Self> {
        waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Asks the connection that has waited longest to close; without one, the next that will wait.
    fn make_room(waiting: &Mutex<Self>) {
        let mut waiting = Self::lock(waiting);
        match waiting.by_turn.pop_first() {
            Some((_, leave)) => leave.notify_one(),
            None => waiting.wanted = true,
        }
    }

    /// A further connection begins to wait: its turn, or none if it must close.
    fn join(waiting: &Mutex<Self>, leave: &Arc<Notify>) -> Option<u64> {
        let mut waiting = Self::lock(waiting);
        if std::mem::take(&mut waiting.wanted) {
            leave.notify_one();
            return None;
        }
        waiting.turns += 1;
        let turn = waiting.turns;
        waiting.by_turn.insert(turn, Arc::clone(leave));
        Some(turn)
    }
}

/// What a connection does.
#[derive(Clone, Copy, Debug)]
enum Doing {
    /// It works on a request.
    Working,
    /// Its answer is there, but the network has not taken all of it.
    Answering,
    /// It waits for a request, since then: with its turn, or none if it must close.
    Waiting(Option<u64>, Instant),
}

/// A connection's place among those that wait.
#[derive(Debug)]
struct Place {
    waiting: Arc<Mutex<Waiting>>,
    doing: Mutex<Doing>,
    leave: Arc<Notify>,
}

impl Place {
    /// The place of a new connection, which waits.
    fn new(waiting: &Arc<Mutex<Waiting>>) -> Arc<Self> {
        let place = Self {
            waiting: Arc::clone(waiting),
            doing: Mutex::new(Doing::Working),
            leave: Arc::default(),
        };
        place.wait();
        Arc::new(place)
    }

    fn doing(&self) -> MutexGuard<'_, Doing> {
        self.doing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait(&self) {
        let turn = Waiting::join(&self.waiting, &self.leave);
        *self.doing() = Doing::Waiting(turn, Instant::now());
    }

    fn work(&self) {
        let before = std::mem::replace(&mut *self.doing(), Doing::Working);
        if let Doing::Waiting(Some(turn), _) = before {
            Waiting::lock(&self.waiting).by_turn.remove(&turn);
        }
    }

    fn answer(&self) {
        *self.doing() = Doing::Answering;
    }

    /// The network has taken the answer, or its client had time enough.
    fn answered(&self) {
        let now = *self.doing();
        if matches!(now, Doing::Answering) {
            self.wait();
        }
    }

    fn is_waiting(&self) -> bool {
        matches!(*self.doing(), Doing::Waiting(..))
    }

    /// Time that it needs to close: what is left of an answer, which may still be on its way.
    fn time_to_leave(&self) -> Duration {
        match *self.doing() {
            Doing::Waiting(_, since) => ANSWERING.saturating_sub(since.elapsed()),
            Doing::Working | Doing::Answering => Duration::ZERO,
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.work();
    }
}

/// A connection's stream. It knows when the network has taken an answer: hyper flushes only after it has written all that it has. The
/// answers of the gateway are of one piece; of one in several pieces, the first flush would count.
#[derive(Debug)]
struct Stream {
    io: TokioIo<TcpStream>,
    place: Arc<Place>,
    answer_within: Duration,
    /// Runs from the first time that the network did not take more of an answer.
    slow: Option<Pin<Box<Sleep>>>,
}

impl Stream {
    fn written(
        &mut self,
        context: &mut Context<'_>,
        written: Poll<std::io::Result<usize>>,
    ) -> Poll<std::io::Result<usize>> {
        if written.is_pending() {
            let within = self.answer_within;
            let slow = self.slow.get_or_insert_with(|| Box::pin(sleep(within)));
            if slow.as_mut().poll(context).is_ready() {
                self.place.answered();
            }
        }
        written
    }
}

impl Read for Stream {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: ReadBufCursor<'_>,
    ) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.io).poll_read(context, buffer)
    }
}

impl Write for Stream {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<std::io::Result<usize>> {
        let written = Pin::new(&mut self.io).poll_write(context, bytes);
        self.written(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        pieces: &[IoSlice<'_>],
    ) -> Poll<std::io::Result<usize>> {
        let written = Pin::new(&mut self.io).poll_write_vectored(context, pieces);
        self.written(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        let flushed = Pin::new(&mut self.io).poll_flush(context);
        if flushed.is_ready() {
            self.slow = None;
            self.place.answered();
        }
        flushed
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(context)
    }
}

/// Serves connections until `ended`; then closes open connections.
pub(super) async fn serve(
    listener: TcpListener,
    router: Router,
    limits: Limits,
    ended: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    let room = Arc::new(Semaphore::new(limits.most as usize));
    let waiting = Arc::<Mutex<Waiting>>::default();
    let (ending, _) = watch::channel(false);
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(limits.head_within);
    let accept = async {
        loop {
            let stream = match listener.accept().await {
                Ok((stream, _)) => stream,
                Err(error) if is_of_one(&error) => continue,
                Err(error) => {
                    tracing::warn!(%error, "a connection cannot be accepted");
                    tokio::time::sleep(PAUSE).await;
                    continue;
                }
            };
            if room.available_permits() == 0 {
                Waiting::make_room(&waiting);
            }
            let Ok(permit) = Arc::clone(&room).acquire_owned().await else {
                return;
            };
            Waiting::lock(&waiting).wanted = false;
            let place = Place::new(&waiting);
            let service = {
                let (routes, place) = (TowerToHyperService::new(router.clone()), Arc::clone(&place));
                service_fn(move |request: hyper::Request<Incoming>| {
                    place.work();
                    let (answer, place) = (routes.call(request), Arc::clone(&place));
                    async move {
                        let answer = answer.await;
                        place.answer();
                        answer
                    }
                })
            };
            let stream = Stream {
                io: TokioIo::new(stream),
                place: Arc::clone(&place),
                answer_within: limits.answer_within,
                slow: None,
            };
            let connection = http.serve_connection(stream, service).with_upgrades();
            let mut end = ending.subscribe();
            tokio::spawn(async move {
                let mut connection = pin!(connection);
                // A client that disconnects is not an error of this side.
                loop {
                    tokio::select! {
                        _ = connection.as_mut() => break,
                        () = place.leave.notified() => {
                            connection.as_mut().graceful_shutdown();
                            let closed = timeout(place.time_to_leave(), connection.as_mut()).await.is_ok();
                            if closed || place.is_waiting() {
                                break;
                            }
                            // A request came meanwhile, and is answered first: another connection must close.
                            Waiting::make_room(&place.waiting);
                        }
                        _ = end.changed() => {
                            connection.as_mut().graceful_shutdown();
                            let _ = connection.as_mut().await;
                            break;
                        }
                    }
                }
                // Whoever takes the room that is left must find no place of this connection.
                place.work();
                drop(permit);
            });
        }
    };
    tokio::select! {
        () = accept => {}
        () = ended => {}
    }
    ending.send_replace(true);
    let _ = timeout(ENDING, room.acquire_many(limits.most)).await;
    Ok(())
}

/// Whether an error concerns a single connection: its client disconnected before it was accepted.
fn is_of_one(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    use super::*;

    /// Longer than any test may take.
    const PATIENCE: Duration = Duration::from_secs(60);
    /// Length of an answer that no network takes at once, bytes.
    const LONG: usize = 32 << 20;

    /// Asks for the page on a connection of its own.
    async fn ask(address: std::net::SocketAddr) -> String {
        let asked = async {
            let mut client = TcpStream::connect(address).await.unwrap();
            client
                .write_all(b"GET / HTTP/1.1\r\nhost: robots\r\nconnection: close\r\n\r\n")
                .await
                .unwrap();
            let mut answer = String::new();
            client.read_to_string(&mut answer).await.unwrap();
            answer
        };
        timeout(PATIENCE, asked).await.unwrap()
    }

    /// Asks for the long answer, and reads the first bytes of it.
    async fn begin_long(address: std::net::SocketAddr) -> TcpStream {
        let mut client = TcpStream::connect(address).await.unwrap();
        client
            .write_all(b"GET /long HTTP/1.1\r\nhost: robots\r\n\r\n")
            .await
            .unwrap();
        let mut start = [0; 12];
        timeout(PATIENCE, client.read_exact(&mut start)).await.unwrap().unwrap();
        assert_eq!(&start, b"HTTP/1.1 200");
        client
    }

    fn routes() -> Router {
        Router::new()
            .route("/", axum::routing::get(|| async { "here" }))
            .route("/long", axum::routing::get(|| async { vec![b'.'; LONG] }))
    }

    /// Time limits that no test reaches.
    const PATIENT: Limits = Limits {
        most: 1,
        head_within: Duration::from_secs(3600),
        answer_within: Duration::from_secs(3600),
    };

    /// A running server.
    struct Server {
        end: tokio::sync::oneshot::Sender<()>,
        served: tokio::task::JoinHandle<std::io::Result<()>>,
    }

    impl Server {
        async fn end(self) {
            drop(self.end);
            self.served.await.unwrap().unwrap();
        }
    }

    async fn begin(limits: Limits) -> (std::net::SocketAddr, Server) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (end, ended) = tokio::sync::oneshot::channel::<()>();
        let served = tokio::spawn(serve(listener, routes(), limits, async { drop(ended.await) }));
        (address, Server { end, served })
    }

    #[tokio::test]
    async fn who_waits_makes_room_for_who_asks() {
        let (address, server) = begin(Limits { most: 2, ..PATIENT }).await;
        let mut idle = Vec::new();
        for said in [b"".as_slice(), b"GET / HTT", b"", b"GET"] {
            let mut connection = TcpStream::connect(address).await.unwrap();
            connection.write_all(said).await.unwrap();
            idle.push(connection);
        }
        let answer = ask(address).await;
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        drop(idle);
        server.end().await;
    }

    #[tokio::test]
    async fn a_long_answer_is_not_cut_off_for_who_comes() {
        let (address, server) = begin(Limits { most: 2, ..PATIENT }).await;
        let mut client = begin_long(address).await;
        let idle = TcpStream::connect(address).await.unwrap();
        let answer = ask(address).await;
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        let mut rest = vec![0; LONG];
        timeout(PATIENCE, client.read_exact(&mut rest)).await.unwrap().unwrap();
        drop((client, idle));
        server.end().await;
    }

    #[tokio::test]
    async fn who_does_not_read_an_answer_keeps_nobody_out() {
        let (address, server) = begin(Limits {
            most: 1,
            answer_within: Duration::from_millis(50),
            ..PATIENT
        })
        .await;
        let client = begin_long(address).await;
        let answer = ask(address).await;
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        drop(client);
        server.end().await;
    }

    #[tokio::test]
    async fn who_connects_and_says_nothing_is_closed() {
        // Room for one more: only the time limit closes the silent one.
        let (address, server) = begin(Limits {
            most: 2,
            head_within: Duration::from_millis(50),
            ..PATIENT
        })
        .await;
        let mut silent = TcpStream::connect(address).await.unwrap();
        let mut rest = Vec::new();
        let closed = timeout(PATIENCE, silent.read_to_end(&mut rest)).await;
        let said = closed.unwrap().unwrap_or_default();
        assert!(said == 0 || rest.starts_with(b"HTTP/1.1 408"), "it was closed");
        let answer = ask(address).await;
        assert!(
            answer.starts_with("HTTP/1.1 200") && answer.ends_with("here"),
            "{answer}"
        );
        server.end().await;
    }
}
