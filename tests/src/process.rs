//! Processes. How does a test start and end real processes? As a user does, on free ports.

use std::ffi::OsStr;
use std::io::{BufRead as _, BufReader, Read};
use std::net::TcpListener;
use std::ops::Range;
use std::path::Path;
use std::process::{self, Child, Command, Output, Stdio};
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

/// Ports below those that the system hands out by itself: neither a link's own port nor a part that listens on port 0 takes one of them.
const PORTS: Range<u32> = 10_000..32_000;

/// A free loopback endpoint, for as long as this process runs another one at each call.
///
/// Two tests that run as processes of their own begin at different ports.
///
/// # Panics
/// When the machine has no free port.
#[must_use]
pub fn free_endpoint() -> String {
    static GIVEN: AtomicU32 = AtomicU32::new(0);
    let count = PORTS.end - PORTS.start;
    // A golden ratio's share of all ports from one process to the next.
    let first = process::id().wrapping_mul(13_597) % count;
    #[expect(clippy::expect_used, reason = "a test cannot go on without a port")]
    let port = (0..count)
        .map(|_| PORTS.start + (first + GIVEN.fetch_add(1, Ordering::Relaxed)) % count)
        .filter_map(|port| u16::try_from(port).ok())
        .find(|&port| TcpListener::bind(("127.0.0.1", port)).is_ok())
        .expect("a free port");
    format!("tcp/127.0.0.1:{port}")
}

impl Process {
    /// Starts `binary` with arguments in a folder.
    ///
    /// # Panics
    /// When it cannot be started.
    #[must_use]
    pub fn start(binary: impl AsRef<OsStr>, arguments: &[&str], folder: &Path) -> Self {
        #[expect(clippy::expect_used, reason = "a test cannot go on without its process")]
        let mut child = Command::new(binary)
            .args(arguments)
            .current_dir(folder)
            .env("RUST_LOG", "info,zenoh=error")
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

    /// Interrupts it as Ctrl-C does (`SIGINT`) and waits for its end; its exit code.
    ///
    /// # Errors
    /// When the signal cannot be sent, it does not end in time, or a signal ended it.
    pub fn interrupt(&mut self, limit: Duration) -> Result<i32, String> {
        self.signal(rustix::process::Signal::INT)?;
        let deadline = Instant::now() + limit;
        while Instant::now() < deadline {
            if let Ok(Some(status)) = self.child.try_wait() {
                return status.code().ok_or_else(|| format!("`zenav {}`: {status}", self.name));
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

    /// The first line of its log that contains a text, which may still have to come.
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
            // Its end closes the pipe: the log is whole.
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
        // The end of a child cannot be awaited with a deadline otherwise in std.
        std::thread::park_timeout(Duration::from_millis(10));
    };
    Output {
        status,
        stdout: stdout.join().unwrap_or_default(),
        stderr: stderr.join().unwrap_or_default(),
    }
}
