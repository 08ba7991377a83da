//! Processes. Real processes, started and ended as a user does, on free ports.

use std::ffi::OsStr;
use std::io::{BufRead as _, BufReader, Read};
use std::net::TcpListener;
use std::ops::Range;
use std::path::Path;
use std::process::{self, Child, Command, ExitStatus, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// A started process; killed when dropped.
#[derive(Debug)]
pub struct Process {
    child: Child,
    name: String,
    log: mpsc::Receiver<String>,
    seen: Vec<String>,
}

/// Ports below the system's ephemeral range: neither a link's local port nor a part that listens on port 0 takes one of them.
const PORTS: Range<u32> = 10_000..32_000;

/// What a process logs, as in `RUST_LOG`.
pub(crate) const LOGGED: &str = "info,zenoh=error";

/// A free loopback endpoint; each call of a process gives another one.
///
/// Tests in different processes begin at different ports.
///
/// # Panics
/// When the machine has no free port.
#[must_use]
pub fn free_endpoint() -> String {
    static GIVEN: AtomicU32 = AtomicU32::new(0);
    let count = PORTS.end - PORTS.start;
    // From one process id to the next the start advances by the golden ratio of all ports.
    let first = process::id().wrapping_mul(13_597) % count;
    #[expect(clippy::expect_used, reason = "a test cannot go on without a port")]
    let port = (0..count)
        .map(|_| PORTS.start + (first + GIVEN.fetch_add(1, Ordering::Relaxed)) % count)
        .filter_map(|port| u16::try_from(port).ok())
        .find(|&port| TcpListener::bind(("127.0.0.1", port)).is_ok())
        .expect("a free port");
    format!("tcp/127.0.0.1:{port}")
}

/// The words of a command line, split at its spaces.
pub(crate) fn words(line: &str) -> Vec<&str> {
    line.split(' ').collect()
}

impl Process {
    /// Starts `binary` with arguments in a folder.
    ///
    /// # Panics
    /// When the binary cannot be started.
    #[must_use]
    pub fn start(binary: impl AsRef<OsStr>, arguments: &[&str], folder: &Path) -> Self {
        Self::start_logging(binary, arguments, folder, LOGGED)
    }

    /// Like [`Self::start`]; `logged` is what it logs, as in `RUST_LOG`.
    ///
    /// # Panics
    /// When the binary cannot be started.
    #[must_use]
    pub fn start_logging(binary: impl AsRef<OsStr>, arguments: &[&str], folder: &Path, logged: &str) -> Self {
        #[expect(clippy::expect_used, reason = "a test cannot go on without its process")]
        let mut child = Command::new(binary)
            .args(arguments)
            .current_dir(folder)
            .env("RUST_LOG", logged)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary under test starts");
        let (sender, log) = mpsc::channel();
        if let Some(stderr) = child.stderr.take() {
            std::thread::spawn(move || {
                for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                    if sender.send(line).is_err() {
                        return;
                    }
                }
            });
        }
        Self {
            child,
            name: arguments.join(" "),
            log,
            seen: Vec::new(),
        }
    }

    /// Process id.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Kills it at once (`SIGKILL`).
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Interrupts it as Ctrl-C does (`SIGINT`), waits for its end, and returns its exit code.
    ///
    /// # Errors
    /// When the signal cannot be sent, or the process does not end in time or is ended by a signal.
    pub fn interrupt(&mut self, limit: Duration) -> Result<i32, String> {
        self.signal(rustix::process::Signal::INT)?;
        let status = self.ended_within(limit)?;
        status.code().ok_or_else(|| format!("`zenav {}`: {status}", self.name))
    }

    /// Ends it as a service manager does (`SIGTERM`), and waits for its end. One that has not begun yet is ended by the signal itself.
    ///
    /// # Errors
    /// When the signal cannot be sent, or the process does not end in time.
    pub fn terminate(&mut self, limit: Duration) -> Result<(), String> {
        self.signal(rustix::process::Signal::TERM)?;
        self.ended_within(limit).map(drop)
    }

    fn ended_within(&mut self, limit: Duration) -> Result<ExitStatus, String> {
        let deadline = Instant::now() + limit;
        while Instant::now() < deadline {
            if let Ok(Some(status)) = self.child.try_wait() {
                return Ok(status);
            }
            std::thread::park_timeout(Duration::from_millis(10));
        }
        Err(format!("`zenav {}` does not end", self.name))
    }

    /// Pauses it (`SIGSTOP`).
    ///
    /// # Errors
    /// When the signal cannot be sent.
    pub fn pause(&self) -> Result<(), String> {
        self.signal(rustix::process::Signal::STOP)
    }

    /// Resumes it (`SIGCONT`).
    ///
    /// # Errors
    /// When the signal cannot be sent.
    pub fn resume(&self) -> Result<(), String> {
        self.signal(rustix::process::Signal::CONT)
    }

    fn signal(&self, signal: rustix::process::Signal) -> Result<(), String> {
        let id = i32::try_from(self.child.id())
            .ok()
            .and_then(rustix::process::Pid::from_raw);
        let id = id.ok_or_else(|| format!("`zenav {}` has no process id", self.name))?;
        rustix::process::kill_process(id, signal).map_err(|error| error.to_string())
    }

    /// Whether it still runs.
    #[must_use]
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Asserts that it still runs.
    ///
    /// # Panics
    /// With its log, when it does not.
    pub fn assert_running(&mut self) {
        assert!(self.is_running(), "`zenav {}` has ended", self.name);
    }

    /// Waits for the first line of its log that contains a text.
    ///
    /// # Panics
    /// When it does not come in time, or the process ends without it.
    #[track_caller]
    pub fn until(&mut self, text: &str, limit: Duration) -> String {
        let deadline = Instant::now() + limit;
        if let Some(line) = self.seen.iter().find(|line| line.contains(text)) {
            return line.clone();
        }
        while let Ok(line) = self
            .log
            .recv_timeout(deadline.saturating_duration_since(Instant::now()))
        {
            let found = line.contains(text);
            self.seen.push(line.clone());
            if found {
                return line;
            }
        }
        panic!("`zenav {}` does not say {text:?}", self.name);
    }

    /// Its log so far.
    pub fn log(&mut self) -> String {
        self.seen.extend(self.log.try_iter());
        self.seen.join("\n")
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
        if std::thread::panicking() {
            // The end of the process closes the pipe, so the log is complete.
            self.seen.extend(self.log.iter());
            eprintln!("--- zenav {} ---\n{}", self.name, self.seen.join("\n"));
        }
    }
}

/// Runs `binary` to its end, at most `limit` long.
///
/// # Panics
/// When it cannot be started or does not end in time.
#[must_use]
pub fn run(binary: impl AsRef<OsStr>, arguments: &[&str], folder: &Path, limit: Duration) -> Output {
    #[expect(clippy::expect_used, reason = "a test cannot go on without its process")]
    let mut child = Command::new(binary)
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary under test starts");
    let read = |pipe: Option<Box<dyn Read + Send>>| {
        std::thread::spawn(move || {
            let mut bytes = Vec::new();
            if let Some(mut pipe) = pipe {
                let _ = pipe.read_to_end(&mut bytes);
            }
            bytes
        })
    };
    let stdout = read(child.stdout.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>));
    let stderr = read(child.stderr.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>));
    let deadline = Instant::now() + limit;
    let status = loop {
        if let Ok(Some(status)) = child.try_wait() {
            break status;
        }
        if Instant::now() > deadline {
            let _ = child.kill();
            let _ = child.wait();
            let said = String::from_utf8_lossy(&stderr.join().unwrap_or_default()).into_owned();
            panic!("`{}` did not end within {limit:?}: {said}", arguments.join(" "));
        }
        // std has no wait for a child with a deadline.
        std::thread::park_timeout(Duration::from_millis(10));
    };
    Output {
        status,
        stdout: stdout.join().unwrap_or_default(),
        stderr: stderr.join().unwrap_or_default(),
    }
}
