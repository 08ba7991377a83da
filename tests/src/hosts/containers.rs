//! Containers. The rendered compose file on this machine's engine: one container per part, each with its own address.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};
use tempfile::TempDir;

use super::{HOSTS, KEYS, NETWORKS, Site, answers, checked, render};

/// The runtime stage of the image begins here.
const RUNTIME_STAGE: &str = "FROM scratch";

/// The containers' user, which must be able to read the keys.
const USER: &str = "65532:65532";
/// Parts that this process dials, with the network it uses.
const DIALLED: [(&str, &str); 3] = [
    ("fleet-a-router", "fleet"),
    ("fleet-b-router", "fleet"),
    ("hall-world", "bodies"),
];

/// Log filter of the parts; includes Zenoh's message when it closes a link, and when it drops a declaration of another router.
const LOGGED: &str = "info,zenoh=off,zenoh::net::routing::hat=error,zenoh_link=off,zenoh_transport=error";

/// The host of a part.
fn host(part: &str) -> &'static str {
    let host = HOSTS.iter().find(|host| part.starts_with(**host));
    host.copied().unwrap_or_default()
}

/// The fixed address of a part that this process dials.
fn fixed(site: u8, part: &str) -> Option<(&'static str, String)> {
    let (_, network) = DIALLED.iter().find(|(dialled, _)| *dialled == part)?;
    Some((*network, super::address(site, host(part), network)))
}

/// A second compose file with fixed addresses for the parts that this process dials, because certificates name the dialled address.
fn additions<'a>(site: u8, parts: impl Iterator<Item = &'a str>) -> Value {
    let services: Map<String, Value> = parts
        .map(|part| {
            let mut service = json!({ "environment": { "RUST_LOG": LOGGED } });
            if let Some((network, address)) = fixed(site, part) {
                service["networks"] = json!({ "fleet": {} });
                service["networks"][network] = json!({ "ipv4_address": address });
            }
            (part.to_owned(), service)
        })
        .collect();
    let networks: Map<String, Value> = NETWORKS
        .iter()
        .map(|(network, number)| {
            // The engine chooses addresses in the upper half only, so none of them is one of the fixed ones.
            let pool = json!({
                "subnet": format!("10.{number}.{site}.0/24"),
                "ip_range": format!("10.{number}.{site}.128/25"),
            });
            ((*network).to_owned(), json!({ "ipam": { "config": [pool] } }))
        })
        .collect();
    json!({ "services": services, "networks": networks })
}

/// A deployment as containers; dropping it removes everything.
#[derive(Debug)]
pub struct Containers {
    folder: TempDir,
    /// `docker compose` or `docker-compose`, with its file and project.
    compose: Vec<String>,
    project: String,
    /// Number of this site on this machine: part of its addresses.
    site: u8,
    images: [String; 2],
    /// Container of each part.
    ids: BTreeMap<String, String>,
}

/// Why no containers can be started here; `None` when they can.
#[must_use]
pub fn missing() -> Option<String> {
    if !answers("docker", &["info"]) {
        return Some("no container engine answers `docker info`".to_owned());
    }
    compose()
        .is_none()
        .then(|| "neither `docker compose` nor `docker-compose` is installed".to_owned())
}

fn compose() -> Option<Vec<String>> {
    if answers("docker", &["compose", "version"]) {
        return Some(vec!["docker".to_owned(), "compose".to_owned()]);
    }
    answers("docker-compose", &["version"]).then(|| vec!["docker-compose".to_owned()])
}

impl Containers {
    /// Builds the image from a binary, and starts the deployment.
    ///
    /// # Errors
    /// The engine's error.
    pub fn start(binary: &Path, speed: f64) -> Result<Self, String> {
        if let Some(missing) = missing() {
            return Err(missing);
        }
        let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
        let project = format!("zenav-test-{}", std::process::id());
        let number = super::site_number();
        let reached = |host: &str| {
            let dialled = DIALLED.iter().find(|(part, _)| part.starts_with(host));
            dialled.map(|(_, network)| super::address(number, host, network))
        };
        let rendered = render(
            binary,
            folder.path(),
            "compose",
            speed,
            |host| format!("{host}.example"),
            reached,
        )?;
        let keys = folder.path().join(KEYS).join("issued").display().to_string();
        checked("chown", &["-R", USER, &keys], folder.path())?;
        let added = folder.path().join("additions.json");
        let files = [rendered.join("compose.yaml"), added.clone()].map(|file| file.display().to_string());
        let options = ["-p", &project, "-f", &files[0], "-f", &files[1]];
        let compose = [compose().unwrap_or_default(), options.map(str::to_owned).to_vec()].concat();
        let images = ["now", "next"].map(|tag| format!("{project}:{tag}"));
        let mut site = Self {
            folder,
            compose,
            project,
            site: number,
            images,
            ids: BTreeMap::new(),
        };
        site.build(binary)?;
        let write = |text: String| std::fs::write(&added, text).map_err(|error| error.to_string());
        write(additions(number, std::iter::empty()).to_string())?;
        let parts = site.compose(0, &["config", "--services"])?;
        write(additions(number, parts.lines()).to_string())?;
        site.compose(0, &["up", "-d"])?;
        for part in parts.lines() {
            let id = site.compose(0, &["ps", "-q", part])?;
            site.ids.insert(part.to_owned(), id);
        }
        Ok(site)
    }

    /// Builds only the image's last stage, from the existing binary, so no registry is needed. A second tag stands for the next version.
    fn build(&self, binary: &Path) -> Result<(), String> {
        let context = self.folder.path().join("context");
        let sources = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../deploy/container");
        let image = context.join("image").display().to_string();
        std::fs::create_dir_all(&context).map_err(|error| error.to_string())?;
        let script = sources.join("root.sh").display().to_string();
        checked(
            "sh",
            &[&script, &binary.display().to_string(), &image],
            self.folder.path(),
        )?;
        let text = std::fs::read_to_string(sources.join("Dockerfile")).map_err(|error| error.to_string())?;
        let stage = text.find(RUNTIME_STAGE).map(|at| &text[at..]).unwrap_or_default();
        let stage = stage.replace("--from=build ", "");
        std::fs::write(context.join("Dockerfile"), stage).map_err(|error| error.to_string())?;
        for image in &self.images {
            checked("docker", &["build", "-q", "-t", image, "--label", image, "."], &context)?;
        }
        Ok(())
    }

    fn compose(&self, image: usize, arguments: &[&str]) -> Result<String, String> {
        let variable = format!("ZENAV_IMAGE={}", self.images[image]);
        let keys = format!("ZENAV_KEYS={}", self.folder.path().join(KEYS).display());
        let all: Vec<&str> = [variable.as_str(), keys.as_str()]
            .into_iter()
            .chain(self.compose.iter().map(String::as_str))
            .chain(arguments.iter().copied())
            .collect();
        checked("env", &all, self.folder.path())
    }

    fn docker(&self, arguments: &[&str]) -> Result<String, String> {
        checked("docker", arguments, self.folder.path())
    }

    fn id(&self, part: &str) -> Result<&str, String> {
        let id = self.ids.get(part).map(String::as_str);
        id.ok_or_else(|| format!("no container {part}"))
    }

    fn network(&self, network: &str) -> String {
        format!("{}_{network}", self.project)
    }

    /// The parts on a part's host, each with its container.
    fn beside(&self, part: &str) -> Vec<(String, String)> {
        let of_host = self.ids.iter().filter(|(other, _)| host(other) == host(part));
        of_host.map(|(other, id)| (other.clone(), id.clone())).collect()
    }
}

impl Site for Containers {
    fn kind(&self) -> String {
        let version = self
            .docker(&["version", "-f", "{{.Server.Version}}"])
            .unwrap_or_default();
        format!(
            "{} containers of Docker {version}, by the rendered compose file",
            self.ids.len()
        )
    }

    fn parts(&self) -> Vec<String> {
        self.ids.keys().cloned().collect()
    }

    fn number(&self) -> u8 {
        self.site
    }

    fn folder(&self) -> &Path {
        self.folder.path()
    }

    fn kill(&mut self, part: &str) -> Result<(), String> {
        self.docker(&["kill", self.id(part)?]).map(drop)
    }

    fn start(&mut self, part: &str) -> Result<(), String> {
        self.docker(&["start", self.id(part)?]).map(drop)
    }

    fn pause(&mut self, part: &str) -> Result<(), String> {
        self.docker(&["pause", self.id(part)?]).map(drop)
    }

    fn resume(&mut self, part: &str) -> Result<(), String> {
        self.docker(&["unpause", self.id(part)?]).map(drop)
    }

    fn cut(&mut self, part: &str) -> Result<(), String> {
        let (fleet, own, parts) = (self.network("fleet"), self.network(host(part)), self.beside(part));
        if parts.len() > 1 {
            self.docker(&["network", "create", "--internal", &own])?;
        }
        for (part, id) in &parts {
            if parts.len() > 1 {
                self.docker(&["network", "connect", "--alias", part, &own, id])?;
            }
            self.docker(&["network", "disconnect", &fleet, id])?;
        }
        Ok(())
    }

    fn heal(&mut self, part: &str) -> Result<(), String> {
        let (fleet, own, parts) = (self.network("fleet"), self.network(host(part)), self.beside(part));
        for (part, id) in &parts {
            let fixed = fixed(self.site, part).filter(|(network, _)| *network == "fleet");
            let ip = fixed.iter().flat_map(|(_, address)| ["--ip", address.as_str()]);
            let connect: Vec<&str> = ["network", "connect", "--alias", part].into_iter().chain(ip).collect();
            self.docker(&[&connect[..], &[fleet.as_str(), id.as_str()]].concat())?;
            if parts.len() > 1 {
                self.docker(&["network", "disconnect", &own, id])?;
            }
        }
        if parts.len() > 1 {
            self.docker(&["network", "rm", &own])?;
        }
        Ok(())
    }

    fn update(&mut self, part: &str) -> Result<(), String> {
        self.compose(1, &["up", "-d", "--no-deps", part])?;
        let id = self.compose(1, &["ps", "-q", part])?;
        self.ids.insert(part.to_owned(), id);
        Ok(())
    }

    fn process_id(&self, part: &str) -> Result<u32, String> {
        let number = self.docker(&["inspect", "-f", "{{.State.Pid}}", self.id(part)?])?;
        number.parse().map_err(|error| format!("{part}: {error}"))
    }

    fn log(&mut self, part: &str) -> String {
        let Ok(id) = self.id(part) else { return String::new() };
        let output = std::process::Command::new("docker").args(["logs", id]).output();
        output
            .map(|output| String::from_utf8_lossy(&output.stderr).into_owned())
            .unwrap_or_default()
    }
}

impl Drop for Containers {
    fn drop(&mut self) {
        let _ = self.compose(0, &["down", "-v", "-t", "1"]);
        for host in super::ROUTERS {
            let _ = self.docker(&["network", "rm", &self.network(host)]);
        }
        let _ = self.docker(&["rmi", "-f", &self.images[0], &self.images[1]]);
    }
}
