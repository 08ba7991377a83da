//! Rig. Starts, cuts off, kills and freezes the parts.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use rustix::process::{Pid, Resource, Rlimit};
use tempfile::TempDir;
use zenav_protocol::bus::{Bus, BusConfig, Security};
use zenav_protocol::messages::LostPolicy;

use super::OWN_NETWORK;
use super::rows::{Fault, Line, PartKind, Place, Row};
use crate::deployment::ROBOT;
use crate::process::{Process, free_endpoint, words};
use crate::secured;
use crate::usage::memory;

/// The members of a fleet with identities: router, parts of the cloud, robot, and this process. The robot has a router's, because its
/// simulation gives everybody the time.
const ROUTER: &str = "router.site";
const SERVICE: &str = "service.site";
const EDGE: &str = "router.tiago";
const DESK: &str = "operator.desk";

/// Longest wait for a part to accept a session, wall time.
const PATIENCE: Duration = Duration::from_secs(60);

/// The parts of one deployment, and the robot's link.
pub struct Rig {
    binary: PathBuf,
    folder: TempDir,
    /// The router's endpoint for all parts but the robot.
    router: String,
    /// The endpoint that the robot dials: the proxy's if there is one, else the router's.
    line: String,
    /// The robot's own endpoint.
    robot: String,
    proxy: Option<Process>,
    parts: Vec<(PartKind, Process)>,
    lossy: Option<u32>,
    cut: bool,
    /// The row's fault; its part is started so that its clock can be stepped or its disk filled.
    fault: Fault,
    has_identities: bool,
    twin: Option<Process>,
}

/// Longest time for a part to end on request.
const ENDING: Duration = Duration::from_secs(15);
/// Library that fakes the wall clock of a program: Debian's package `libfaketime`.
const FAKETIME: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1";
/// The file with the error of the wall clock.
const CLOCK: &str = "clock";

/// Whether this process runs in the row's own network, which the kernel may impair.
fn own_network() -> bool {
    std::env::var_os(OWN_NETWORK).is_some()
}

impl Rig {
    /// Starts the parts of a row in an order.
    ///
    /// # Errors
    /// When a file cannot be written, keys cannot be made or the network cannot be impaired.
    pub fn start(binary: PathBuf, row: &Row, order: [PartKind; 5]) -> Result<Self, String> {
        let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
        if row.has_identities {
            secured::issue(&binary, folder.path(), &[ROUTER, SERVICE, EDGE, DESK])?;
        }
        let free_endpoint = || match row.has_identities {
            true => free_endpoint().replace("tcp/", "quic/"),
            false => free_endpoint(),
        };
        let mut rig = Self {
            binary,
            folder,
            router: free_endpoint(),
            line: free_endpoint(),
            robot: free_endpoint(),
            proxy: None,
            parts: Vec::new(),
            lossy: None,
            cut: false,
            fault: row.fault,
            has_identities: row.has_identities,
            twin: None,
        };
        if matches!(row.fault, Fault::Clock(..)) && !Path::new(FAKETIME).exists() {
            return Err(format!("no {FAKETIME}: expected the package libfaketime"));
        }
        rig.set_clock(0).map_err(|error| error.to_string())?;
        rig.write_deployment(row).map_err(|error| error.to_string())?;
        rig.impair(row.line)?;
        let copy = row.has_copy.then_some(PartKind::Copy);
        for part in order.into_iter().chain(copy) {
            let process = rig.process(part);
            rig.parts.push((part, process));
        }
        Ok(rig)
    }

    /// Folder of a member's identity, if the parts have identities.
    fn identity(&self, member: &str) -> Option<PathBuf> {
        self.has_identities
            .then(|| secured::identity(self.folder.path(), member))
    }

    fn write_deployment(&self, row: &Row) -> std::io::Result<()> {
        let world = match row.place {
            Place::Kitchen => "kitchen".to_owned(),
            Place::Depot => {
                let file = self.folder.path().join("depot.toml");
                std::fs::write(&file, depot())?;
                file.to_string_lossy().into_owned()
            }
        };
        let on_lost = match row.policy {
            LostPolicy::Stop => "stop",
            _ => "finish_horizon",
        };
        let Self {
            router, line, robot, ..
        } = self;
        for (name, member, connect) in [("cloud.toml", SERVICE, router), ("edge.toml", EDGE, line)] {
            let identity = self.identity(member);
            let security = identity.map(|folder| format!("[security]\nidentity = '{}'\n", folder.display()));
            let security = security.unwrap_or_default();
            let text = format!(
                "[bus]\nconnect = \"{connect}\"\n[simulation]\nworld = '{world}'\n[robots.{ROBOT}]\nmodel = \"tiago\"\nlisten = \"{robot}\"\n\
                 on_lost = \"{on_lost}\"\n{security}"
            );
            std::fs::write(self.folder.path().join(name), text)?;
        }
        Ok(())
    }

    fn impair(&mut self, line: Line) -> Result<(), String> {
        let mut arguments = vec!["netem", "--listen", &self.line, "--to", &self.router];
        let (delay, rate, stall, loss);
        match line {
            Line::Good if own_network() => return Ok(()),
            Line::Loss(percent) if own_network() => {
                self.lossy = Some(percent);
                return self.drop_segments("-A", Some(percent));
            }
            Line::Good => {}
            Line::RoundTrip(millis) => {
                delay = format!("{}us", 500 * millis);
                arguments.extend(["--delay", &delay]);
            }
            Line::Rate(kbit) => {
                rate = format!("{kbit}kbit");
                arguments.extend(["--rate", &rate]);
            }
            Line::RateAndRoundTrip(kbit, millis) => {
                (rate, delay) = (format!("{kbit}kbit"), format!("{}us", 500 * millis));
                arguments.extend(["--rate", &rate, "--delay", &delay]);
            }
            Line::Loss(percent) if self.has_identities => {
                loss = format!("{percent}%");
                arguments.extend(["--loss", &loss]);
            }
            Line::Loss(percent) => {
                // A lost segment holds up later ones for a retransmission; some 50 segments pass in a second.
                stall = format!("200ms/{}ms", 2000 / percent.max(1));
                arguments.extend(["--stall", &stall]);
            }
        }
        self.proxy = Some(Process::start(&self.binary, &arguments, self.folder.path()));
        Ok(())
    }

    /// Drops segments or datagrams of the robot's link in the kernel, both ways: a share of them, or all.
    fn drop_segments(&self, how: &str, percent: Option<u32>) -> Result<(), String> {
        let port = self.line.rsplit(':').next().unwrap_or_default();
        let protocol = if self.has_identities { "udp" } else { "tcp" };
        for way in ["--dport", "--sport"] {
            let mut command = Command::new("iptables");
            command.args(["-w", how, "INPUT", "-p", protocol, way, port]);
            if let Some(percent) = percent {
                let share = format!("{:.2}", f64::from(percent) / 100.0);
                command.args(["-m", "statistic", "--mode", "random", "--probability", &share]);
            }
            let output = command.args(["-j", "DROP"]).output();
            let output = output.map_err(|error| format!("iptables: {error}"))?;
            if !output.status.success() {
                return Err(format!("iptables: {}", String::from_utf8_lossy(&output.stderr)));
            }
        }
        Ok(())
    }

    /// Cuts the robot's link.
    ///
    /// # Errors
    /// When the network cannot be impaired.
    pub fn cut(&mut self) -> Result<(), String> {
        self.cut = true;
        match &self.proxy {
            Some(proxy) => proxy.pause(),
            None => self.drop_segments("-I", None),
        }
    }

    /// Heals the robot's link.
    ///
    /// # Errors
    /// When the network cannot be healed.
    pub fn heal(&mut self) -> Result<(), String> {
        self.cut = false;
        match &self.proxy {
            Some(proxy) => proxy.resume(),
            None => self.drop_segments("-D", None),
        }
    }

    fn process(&self, part: PartKind) -> Process {
        let start = |arguments: &[&str]| self.start_as(part, arguments);
        let cloud_in = |service, data| start(&["cloud", service, "--deployment", "cloud.toml", "--data", data]);
        let cloud = |service| cloud_in(service, "cloud");
        match part {
            // Without a proxy the robot has its own endpoint at the router, so that only its link is impaired.
            PartKind::Router => {
                let mut arguments = vec!["router", "--listen", &self.router];
                if self.proxy.is_none() {
                    arguments.extend(["--listen", &self.line]);
                }
                let identity = self.identity(ROUTER).map(|folder| folder.display().to_string());
                arguments.extend(identity.iter().flat_map(|folder| ["--identity", folder]));
                start(&arguments)
            }
            PartKind::Edge => start(&["edge", "--deployment", "edge.toml", "--data", "edge"]),
            PartKind::Mapping => cloud("mapping"),
            PartKind::Motion => cloud("motion"),
            PartKind::Mission => cloud("mission"),
            PartKind::Copy => cloud_in("mapping", "copy"),
        }
    }

    /// Starts a part so that the row's fault can be injected into it.
    fn start_as(&self, part: PartKind, arguments: &[&str]) -> Process {
        let (binary, folder) = (self.binary.to_string_lossy(), self.folder.path());
        match self.fault {
            // A write without room returns an error instead of raising a signal.
            Fault::Full(of, _) if of == part => {
                let begin = ["-c", "trap '' XFSZ; exec \"$0\" \"$@\"", &binary];
                Process::start("sh", &[&begin, arguments].concat(), folder)
            }
            Fault::Clock(of, ..) if of == part => {
                let file = format!("FAKETIME_TIMESTAMP_FILE={}", folder.join(CLOCK).display());
                let begin = [
                    &format!("LD_PRELOAD={FAKETIME}"),
                    &file,
                    // A real monotonic clock never steps. The file is read every second.
                    "FAKETIME_DONT_FAKE_MONOTONIC=1",
                    "FAKETIME_CACHE_DURATION=1",
                    &*binary,
                ];
                Process::start("env", &[&begin, arguments].concat(), folder)
            }
            _ => Process::start(&self.binary, arguments, folder),
        }
    }

    /// Sets a part's wall clock ahead, or back with a negative number, s.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn set_clock(&self, ahead: i32) -> std::io::Result<()> {
        std::fs::write(self.folder.path().join(CLOCK), format!("{ahead:+}\n"))
    }

    /// Allows a part to write files, or prevents it.
    ///
    /// # Errors
    /// When the kernel refuses.
    pub fn set_room(&self, part: PartKind, room: bool) -> Result<(), String> {
        let process = self.part(part).ok_or_else(|| format!("{part:?} does not run"))?;
        let current = if room { None } else { Some(0) };
        let id = i32::try_from(process.id()).ok().and_then(Pid::from_raw);
        rustix::process::prlimit(id, Resource::Fsize, Rlimit { current, maximum: None })
            .map(drop)
            .map_err(|error| error.to_string())
    }

    /// Starts or ends a second robot of the same name.
    pub fn set_twin(&mut self, there: bool) {
        let arguments = words("edge --deployment edge.toml --data twin --listen tcp/127.0.0.1:0");
        self.twin = there.then(|| Process::start(&self.binary, &arguments, self.folder.path()));
    }

    /// Kills a part and starts another one in its place.
    pub fn replace(&mut self, part: PartKind) {
        let old = self.parts.iter().position(|(known, _)| *known == part);
        if let Some(place) = old {
            let (_, mut process) = self.parts.swap_remove(place);
            process.kill();
        }
        let new = self.process(part);
        self.parts.push((part, new));
    }

    /// Ends a part as a service manager does, and starts another one in its place.
    ///
    /// # Errors
    /// When it does not end.
    pub fn restart(&mut self, part: PartKind) -> Result<(), String> {
        let old = self.parts.iter_mut().find(|(known, _)| *known == part);
        old.map_or(Ok(()), |(_, process)| process.terminate(ENDING))?;
        self.replace(part);
        Ok(())
    }

    /// A part's process.
    pub fn part(&self, part: PartKind) -> Option<&Process> {
        self.parts
            .iter()
            .find(|(known, _)| *known == part)
            .map(|(_, process)| process)
    }

    /// The part that runs in a process.
    #[must_use]
    pub fn part_of(&self, process: u32) -> Option<PartKind> {
        self.parts
            .iter()
            .find(|(_, known)| known.id() == process)
            .map(|(part, _)| *part)
    }

    /// Memory of every part, MiB, by part and process.
    #[must_use]
    pub fn memory(&self) -> BTreeMap<(PartKind, u32), f64> {
        let resident = |(part, process): &(PartKind, Process)| {
            let bytes = memory(process.id()).unwrap_or_default();
            ((*part, process.id()), bytes as f64 / (1024.0 * 1024.0))
        };
        self.parts.iter().map(resident).collect()
    }

    /// The parts that have ended by themselves, each with the end of its log.
    pub fn ended(&mut self) -> Vec<String> {
        let mut ended = Vec::new();
        for (part, process) in &mut self.parts {
            if !process.is_running() {
                let log = process.log();
                let mut text = format!("{} has ended", part.name());
                let _ = write!(text, ": {}", log.lines().last().unwrap_or_default());
                ended.push(text);
            }
        }
        ended
    }

    /// Opens sessions at the cloud's router and at the robot, both over unimpaired links.
    ///
    /// # Errors
    /// When a session does not open in time.
    pub async fn join(&self) -> Result<(Bus, Bus), String> {
        let identity = self.identity(DESK);
        let security = Security::of(identity.as_deref(), false).map_err(|error| error.to_string())?;
        let open = async |name: &'static str, endpoint: &str| {
            let config = BusConfig {
                security: security.clone(),
                ..BusConfig::service(name, endpoint)
            };
            let opened = tokio::time::timeout(PATIENCE, Bus::open(config)).await;
            let opened = opened.map_err(|_| format!("nobody listens on {endpoint}"))?;
            opened.map_err(|error| error.to_string())
        };
        Ok((open("client", &self.router).await?, open("watch", &self.robot).await?))
    }
}

/// A hall of 20 m by 10 m with three rows of shelves and aisles of 1.9 m.
fn depot() -> String {
    let mut text = String::from("name = \"depot\"\nsize = [20.0, 10.0]\norigin = [-1.0, -5.0]\n");
    let mut wall = |from: (f64, f64), to: (f64, f64), thickness: f64| {
        let _ = writeln!(
            text,
            "[[wall]]\nfrom = [{:?}, {:?}]\nto = [{:?}, {:?}]\nthickness = {thickness:?}",
            from.0, from.1, to.0, to.1
        );
    };
    for y in [-4.9, 4.9] {
        wall((-0.9, y), (18.9, y), 0.1);
    }
    for x in [-0.9, 18.9] {
        wall((x, -4.9), (x, 4.9), 0.1);
    }
    for y in [-2.4, 0.9, 3.2] {
        wall((2.0, y), (15.5, y), 0.6);
    }
    text
}
