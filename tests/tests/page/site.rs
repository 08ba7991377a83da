//! A site with a page: starts it, and operates its map.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde_json::Value;
use zenav_tests::browser::Browser;
use zenav_tests::deployment::Deployment;
use zenav_tests::process::{Process, free_endpoint};

pub const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Simulated seconds per second.
const SPEED: f64 = 3.0;
/// Longest wait for a quick reaction.
pub const SOON: Duration = Duration::from_secs(30);
/// Longest wait for a drive.
pub const DRIVE: Duration = Duration::from_secs(120);
pub const ENTER: &str = "\u{E007}";
pub const ESCAPE: &str = "\u{E00C}";
/// The robot's state in the page, as JavaScript.
pub const STATE: &str = "zenav.store.data('state')";

static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Waits until no other test of this file drives a browser: each needs the whole machine.
pub fn my_turn() -> MutexGuard<'static, ()> {
    ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner)
}

fn pictures() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("page");
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// Starts `zenav gateway` and waits for its address.
pub fn start_gateway(folder: &Path, router: &str, more: &[&str]) -> (Process, String) {
    let arguments = [&["gateway", "--connect", router, "--world", "kitchen"][..], more].concat();
    let mut gateway = Process::start(ZENAV, &arguments, folder);
    let line = gateway.until("mission control: ", SOON);
    let (_, address) = line.split_once("mission control: ").unwrap();
    (gateway, address.to_owned())
}

/// A kitchen with its robot, and a browser on the page.
pub struct Site {
    pub browser: Browser,
    pub gateway: Process,
    pub cloud: Process,
    _edge: Process,
    _router: Process,
    pub deployment: Deployment,
    /// Address of the gateway.
    pub listen: String,
    pictures: PathBuf,
}

impl Site {
    /// Starts everything, and waits until the map is shown and the mission is in command.
    pub fn open() -> Self {
        Self::open_at(SPEED)
    }

    /// The same at this simulation speed.
    pub fn open_at(speed: f64) -> Self {
        let deployment = Deployment::new(ZENAV, "kitchen", speed);
        let (router, edge, cloud) = (
            deployment.start_router(),
            deployment.start_edge(),
            deployment.start_cloud(),
        );
        let listen = free_endpoint().replace("tcp/", "");
        let (gateway, address) = start_gateway(deployment.folder(), &deployment.router, &["--listen", &listen]);
        let browser = Browser::open(1280, 860);
        browser.resize(1280, 860);
        browser.go(&address);
        browser.until(
            "the map comes",
            SOON,
            "zenav.store.raster.known() && zenav.store.data('model') && zenav.store.detail.has('scan')",
        );
        browser.until("the mission commands", SOON, &format!("{STATE}.lease.live"));
        browser.click("#fit");
        Self {
            browser,
            gateway,
            cloud,
            _edge: edge,
            _router: router,
            deployment,
            listen,
            pictures: pictures(),
        }
    }

    /// Saves a screenshot of the page.
    pub fn shoot(&self, name: &str) {
        let _ = self
            .browser
            .script("document.getElementById('toasts').replaceChildren()");
        self.browser.screenshot(&self.pictures.join(format!("{name}.png")));
    }

    /// Window position of a map position, pixels.
    pub fn in_window(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let place = self.browser.script(&format!(
            "const box = document.getElementById('map').getBoundingClientRect(); const at = zenav.view.camera.toScreen({x}, {y}); \
             return [at[0] + box.left, at[1] + box.top]"
        ));
        [number(&place[0]), number(&place[1])]
    }

    /// Clicks on a map position.
    pub fn click_at(&self, place: [f64; 2]) {
        let at = self.in_window(place);
        self.browser.drag(at, at);
    }

    /// Presses on a map position and drags to another one.
    pub fn drag(&self, from: [f64; 2], to: [f64; 2]) {
        self.browser.drag(self.in_window(from), self.in_window(to));
    }

    /// Types into the focused field.
    pub fn write(&self, text: &str) {
        for letter in text.chars() {
            self.browser.key(&letter.to_string());
        }
    }

    /// Waits until the page has drawn itself a few times.
    pub fn settle(&self) {
        let drawn = number(&self.browser.script("return zenav.view.drawn"));
        self.browser
            .until("it draws", SOON, &format!("zenav.view.drawn > {drawn} + 5"));
    }

    /// Errors thrown by the page since the last call.
    pub fn thrown(&self) -> Vec<String> {
        let lines = self.browser.errors().into_iter();
        lines
            .filter(|line| line.contains("Uncaught") || line.contains("Error:"))
            .collect()
    }
}

pub fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Waits until a condition outside the page holds.
pub fn until(what: &str, limit: Duration, mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < limit, "not within {limit:?}: {what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}
