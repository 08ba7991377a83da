//! Network namespaces. The rendered units' commands, each host in its own network namespace, for machines without a container engine. Needs
//! root and `ip`.
//!
//! ```text
//! this process ── wire ── [switch: fleet ─┬─ fleet-a   bodies ─┬─ hall
//!                                         ├─ ...               └─ robot-a ...]
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tempfile::TempDir;

use super::{HOSTS, KEYS, NETWORKS, Site, answers, checked, render};
use crate::process::Process;

/// Time limit for a part to end on request.
const ENDING: Duration = Duration::from_secs(15);

/// A deployment in network namespaces; dropping it removes everything.
#[derive(Debug)]
pub struct Namespaces {
    folder: TempDir,
    binary: PathBuf,
    /// Number of this site on this machine: part of its addresses.
    site: u8,
    prefix: String,
    /// Host and command of each part.
    commands: BTreeMap<String, (String, Vec<String>)>,
    processes: BTreeMap<String, Process>,
    /// What the earlier processes of each part logged.
    past: BTreeMap<String, String>,
}

/// Why no namespaces can be created here; `None` when they can.
#[must_use]
pub fn missing() -> Option<String> {
    let name = format!("zenav-probe-{}", std::process::id());
    if !answers("ip", &["netns", "add", &name]) {
        return Some("`ip netns add` fails: expected iproute2, and to be root".to_owned());
    }
    let _ = checked("ip", &["netns", "del", &name], Path::new("."));
    None
}

impl Namespaces {
    /// Creates the hosts, and starts every part.
    ///
    /// # Errors
    /// The system's error.
    pub fn start(binary: &Path, speed: f64) -> Result<Self, String> {
        if let Some(missing) = missing() {
            return Err(missing);
        }
        let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
        let mut site = Self {
            folder,
            binary: binary.to_owned(),
            site: super::site_number(),
            prefix: format!("zn{}", std::process::id()),
            commands: BTreeMap::new(),
            processes: BTreeMap::new(),
            past: BTreeMap::new(),
        };
        site.wire()?;
        let address = |host: &str| match host {
            // Only the robots in the world dial it.
            "hall" => super::address(site.site, host, "bodies"),
            host => super::address(site.site, host, "fleet"),
        };
        let rendered = render(binary, site.folder.path(), "systemd", speed, address, |_| None)?;
        for host in HOSTS {
            let units = std::fs::read_dir(rendered.join("hosts").join(host).join("systemd"));
            for unit in units.map_err(|error| error.to_string())?.flatten() {
                let text = std::fs::read_to_string(unit.path()).map_err(|error| error.to_string())?;
                let name = unit.file_name().to_string_lossy().into_owned();
                let part = name.trim_start_matches("zenav-").trim_end_matches(".service");
                let command = site.command(host, &text, &rendered);
                site.commands
                    .insert(format!("{host}-{part}"), (host.to_owned(), command));
            }
        }
        let parts: Vec<String> = site.commands.keys().cloned().collect();
        for part in parts {
            site.start(&part)?;
        }
        Ok(site)
    }

    fn ip(&self, arguments: &[&str]) -> Result<(), String> {
        checked("ip", arguments, self.folder.path()).map(drop)
    }

    fn namespace(&self, host: &str) -> String {
        format!("{}-{host}", self.prefix)
    }

    /// A switch in its own namespace, where no firewall rule of this machine applies, with a wire to each host and one to this process.
    fn wire(&self) -> Result<(), String> {
        let switch = self.namespace("switch");
        self.ip(&["netns", "add", &switch])?;
        for (network, _) in NETWORKS {
            self.ip(&["-n", &switch, "link", "add", network, "type", "bridge"])?;
            self.ip(&["-n", &switch, "link", "set", network, "up"])?;
            let own = format!("{}{}", self.prefix, &network[..1]);
            let far = format!("root-{}", &network[..1]);
            self.ip(&[
                "link", "add", &own, "type", "veth", "peer", "name", &far, "netns", &switch,
            ])?;
            self.ip(&["-n", &switch, "link", "set", &far, "master", network, "up"])?;
            let address = format!("{}/24", super::numbered(self.site, network, 1));
            self.ip(&["addr", "add", &address, "dev", &own])?;
            self.ip(&["link", "set", &own, "up"])?;
        }
        for host in HOSTS {
            let namespace = self.namespace(host);
            self.ip(&["netns", "add", &namespace])?;
            self.ip(&["-n", &namespace, "link", "set", "lo", "up"])?;
            let is_in_the_world = host == "hall" || host.starts_with("robot");
            let networks: &[&str] = if is_in_the_world {
                &["fleet", "bodies"]
            } else {
                &["fleet"]
            };
            for network in networks {
                let far = format!("{host}-{}", &network[..1]);
                self.ip(&[
                    "-n", &namespace, "link", "add", network, "type", "veth", "peer", "name", &far, "netns", &switch,
                ])?;
                self.ip(&["-n", &switch, "link", "set", &far, "master", network, "up"])?;
                let address = format!("{}/24", super::address(self.site, host, network));
                self.ip(&["-n", &namespace, "addr", "add", &address, "dev", network])?;
                self.ip(&["-n", &namespace, "link", "set", network, "up"])?;
            }
        }
        Ok(())
    }

    /// The arguments of a unit's command, with the host's folders replaced by this site's.
    fn command(&self, host: &str, unit: &str, rendered: &Path) -> Vec<String> {
        let line = unit
            .lines()
            .find_map(|line| line.strip_prefix("ExecStart=/usr/bin/zenav "));
        let state = self.folder.path().join(host).display().to_string();
        let config = rendered.join("etc").display().to_string();
        // systemd gives the part a copy of its identity.
        let member = unit.lines().find_map(|line| {
            line.strip_prefix("LoadCredential=cert.pem:/etc/zenav-identity/")?
                .strip_suffix("/cert.pem")
        });
        let identity = self
            .folder
            .path()
            .join(KEYS)
            .join("issued")
            .join(member.unwrap_or_default());
        let identity = identity.display().to_string();
        let words = line.unwrap_or_default().split(' ');
        words
            .map(|word| {
                word.replace("/etc/zenav", &config)
                    .replace("%S", &state)
                    .replace("%d", &identity)
            })
            .collect()
    }

    fn process(&mut self, part: &str) -> Result<&mut Process, String> {
        self.processes.get_mut(part).ok_or_else(|| format!("no part {part}"))
    }

    /// The host of a part.
    fn host(&self, part: &str) -> Result<&str, String> {
        let command = self.commands.get(part).ok_or_else(|| format!("no part {part}"))?;
        Ok(&command.0)
    }
}

impl Site for Namespaces {
    fn kind(&self) -> String {
        format!(
            "{} processes of {} network namespaces, by the rendered units",
            self.commands.len(),
            HOSTS.len()
        )
    }

    fn parts(&self) -> Vec<String> {
        self.commands.keys().cloned().collect()
    }

    fn number(&self) -> u8 {
        self.site
    }

    fn folder(&self) -> &Path {
        self.folder.path()
    }

    fn kill(&mut self, part: &str) -> Result<(), String> {
        self.process(part)?.kill();
        Ok(())
    }

    fn start(&mut self, part: &str) -> Result<(), String> {
        let (host, command) = self.commands.get(part).ok_or_else(|| format!("no part {part}"))?;
        let (namespace, binary) = (self.namespace(host), self.binary.display().to_string());
        let begin = ["netns", "exec", &namespace, &binary];
        let arguments: Vec<&str> = begin.into_iter().chain(command.iter().map(String::as_str)).collect();
        // Relative file names of the deployment are resolved here.
        let folder = self.folder.path().join("rendered/etc");
        let process = Process::start("ip", &arguments, &folder);
        if let Some(mut before) = self.processes.insert(part.to_owned(), process) {
            let past = self.past.entry(part.to_owned()).or_default();
            past.push_str(&before.log());
            past.push('\n');
        }
        Ok(())
    }

    fn pause(&mut self, part: &str) -> Result<(), String> {
        self.process(part)?.pause()
    }

    fn resume(&mut self, part: &str) -> Result<(), String> {
        self.process(part)?.resume()
    }

    fn cut(&mut self, part: &str) -> Result<(), String> {
        let (switch, far) = (self.namespace("switch"), format!("{}-f", self.host(part)?));
        self.ip(&["-n", &switch, "link", "set", &far, "down"])
    }

    fn heal(&mut self, part: &str) -> Result<(), String> {
        let (switch, far) = (self.namespace("switch"), format!("{}-f", self.host(part)?));
        self.ip(&["-n", &switch, "link", "set", &far, "up"])
    }

    fn update(&mut self, part: &str) -> Result<(), String> {
        self.process(part)?.terminate(ENDING)?;
        self.start(part)
    }

    fn process_id(&self, part: &str) -> Result<u32, String> {
        let process = self.processes.get(part).ok_or_else(|| format!("no part {part}"))?;
        Ok(process.id())
    }

    fn log(&mut self, part: &str) -> String {
        let now = self.process(part).map(Process::log).unwrap_or_default();
        self.past.get(part).cloned().unwrap_or_default() + &now
    }
}

impl Drop for Namespaces {
    fn drop(&mut self) {
        self.processes.clear();
        for host in HOSTS.into_iter().chain(["switch"]) {
            let _ = self.ip(&["netns", "del", &self.namespace(host)]);
        }
        for network in ["f", "b"] {
            let _ = self.ip(&["link", "del", &format!("{}{network}", self.prefix)]);
        }
    }
}
