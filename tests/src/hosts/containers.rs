//! Containers. The rendered compose file on this machine's engine: one container a part, each with an address of its own.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::{Site, answers, checked, render};

/// The runtime stage of the image begins here.
const RUNTIME_STAGE: &str = "FROM scratch";

/// A deployment as containers; all of it goes when this is dropped.
#[derive(Debug)]
pub struct Containers {
    folder: TempDir,
    /// `docker compose` or `docker-compose`, and which file and project.
    compose: Vec<String>,
    project: String,
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
    /// Builds the image out of a binary, and starts the deployment.
    ///
    /// # Errors
    /// What the engine says.
    pub fn start(binary: &Path) -> Result<Self, String> {
        if let Some(missing) = missing() {
            return Err(missing);
        }
        let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
        let project = format!("zenav-test-{}", std::process::id());
        let rendered = render(binary, folder.path(), "compose", |host| format!("{host}.example"))?;
        let compose = compose().unwrap_or_default();
        let file = rendered.join("compose.yaml").display().to_string();
        let compose = [compose, ["-p", &project, "-f", &file].map(str::to_owned).to_vec()].concat();
        let images = ["now", "next"].map(|tag| format!("{project}:{tag}"));
        let mut site = Self {
            folder,
            compose,
            project,
            images,
            ids: BTreeMap::new(),
        };
        site.build(binary)?;
        super::only_known_flags(binary, &rendered.join("compose.yaml"))?;
        site.compose(0, &["up", "-d"])?;
        for part in site.compose(0, &["config", "--services"])?.lines() {
            let id = site.compose(0, &["ps", "-q", part])?;
            site.ids.insert(part.to_owned(), id);
        }
        Ok(site)
    }

    /// The image's last stage, from the binary that was built already: no registry is needed. A second tag stands for the next version.
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
        let all: Vec<&str> = [variable.as_str()]
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

    fn endpoint(&self, part: &str, network: &str, port: u16) -> String {
        let network = self.network(network);
        let format = format!("{{{{(index .NetworkSettings.Networks \"{network}\").IPAddress}}}}");
        let address = self
            .id(part)
            .and_then(|id| self.docker(&["inspect", "-f", &format, id]));
        format!("tcp/{}:{port}", address.unwrap_or_default())
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

    fn routers(&self) -> String {
        ["fleet-a-router", "fleet-b-router"]
            .map(|router| self.endpoint(router, "fleet", 7447))
            .join(",")
    }

    fn world(&self) -> String {
        self.endpoint("hall-world", "bodies", 7446)
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
        self.docker(&["network", "disconnect", &self.network("fleet"), self.id(part)?])
            .map(drop)
    }

    fn heal(&mut self, part: &str) -> Result<(), String> {
        let network = self.network("fleet");
        self.docker(&["network", "connect", "--alias", part, &network, self.id(part)?])
            .map(drop)
    }

    fn update(&mut self, part: &str) -> Result<(), String> {
        self.compose(1, &["up", "-d", "--no-deps", part])?;
        let id = self.compose(1, &["ps", "-q", part])?;
        self.ids.insert(part.to_owned(), id);
        Ok(())
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
        let _ = self.docker(&["rmi", "-f", &self.images[0], &self.images[1]]);
    }
}
