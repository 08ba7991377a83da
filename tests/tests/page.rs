//! Does the mission-control page do what a person expects of it? In a real browser, against a router, a robot, a cloud and a gateway that are
//! processes of their own. The screenshots stay in `target/tmp/page`.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::Value;
use zenav_tests::browser::Browser;
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::process::{Process, free_endpoint};

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Simulated seconds a second.
const SPEED: f64 = 3.0;
/// Longest wait for what takes a moment.
const SOON: Duration = Duration::from_secs(30);
/// Longest wait for a drive.
const DRIVE: Duration = Duration::from_secs(120);
const ENTER: &str = "\u{E007}";
const ESCAPE: &str = "\u{E00C}";

fn pictures() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("page");
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn start_gateway(deployment: &Deployment, listen: &str) -> (Process, String) {
    let arguments = [
        "gateway",
        "--connect",
        &deployment.router,
        "--listen",
        listen,
        "--world",
        "kitchen",
    ];
    let mut gateway = Process::start(ZENAV, &arguments, deployment.folder());
    let start = Instant::now();
    loop {
        gateway.assert_running();
        if let Some(line) = gateway
            .log()
            .lines()
            .find_map(|line| line.strip_prefix("mission control: "))
        {
            let address = line.to_owned();
            return (gateway, address);
        }
        assert!(
            start.elapsed() < SOON,
            "the gateway tells no address: {}",
            gateway.log()
        );
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Where a place of the map is in the window, pixels.
fn in_window(browser: &Browser, x: f64, y: f64) -> [f64; 2] {
    let place = browser.script(&format!(
        "const box = document.getElementById('map').getBoundingClientRect(); const at = zenav.view.camera.toScreen({x}, {y}); \
         return [at[0] + box.left, at[1] + box.top]"
    ));
    [place[0].as_f64().unwrap(), place[1].as_f64().unwrap()]
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Waits until the page has drawn itself a few times.
fn settle(browser: &Browser) {
    let drawn = number(&browser.script("return zenav.view.drawn"));
    browser.until("it draws", SOON, &format!("zenav.view.drawn > {drawn} + 5"));
}

const STATE: &str = "zenav.store.data('state')";

/// How many pixels of the map show a wall, free floor and the scan, of its sample of every third.
const PIXELS: &str = r"
    const canvas = document.getElementById('map');
    const style = getComputedStyle(document.documentElement);
    const wanted = ['--map-wall', '--map-free', '--scan'].map((name) => style.getPropertyValue(name).trim())
        .map((hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)));
    const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
    const counts = [0, 0, 0];
    for (let at = 0; at < data.length; at += 12) {
        wanted.forEach((colour, which) => { if (colour.every((part, k) => Math.abs(part - data[at + k]) < 6)) counts[which] += 1; });
    }
    return counts;";

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn a_person_sees_the_robot_sends_it_stops_it_and_is_told_when_the_cloud_is_gone() {
    let deployment = Deployment::new(ZENAV, "kitchen", SPEED);
    let _router = deployment.start_router();
    let _edge = deployment.start_edge();
    let mut cloud = deployment.start_cloud();
    let listen = free_endpoint().replace("tcp/", "");
    let (mut gateway, address) = start_gateway(&deployment, &listen);
    let (browser, folder) = (Browser::open(1280, 860), pictures());
    browser.resize(1280, 860);
    browser.go(&address);
    let shoot = |name: &str| {
        let _ = browser.script("document.getElementById('toasts').replaceChildren()");
        browser.screenshot(&folder.join(format!("{name}.png")));
    };

    // The map is drawn, with what the robot sees.
    browser.until(
        "the map comes",
        SOON,
        "zenav.store.raster.known() && zenav.store.data('model') && zenav.store.detail.has('scan')",
    );
    browser.until("the mission commands", SOON, &format!("{STATE}.lease.live"));
    let drawn = Instant::now();
    loop {
        let counts = browser.script(PIXELS);
        if number(&counts[0]) > 300.0 && number(&counts[1]) > 5000.0 && number(&counts[2]) > 30.0 {
            break;
        }
        assert!(drawn.elapsed() < SOON, "walls, floor and scan: {counts} pixels");
    }

    // A drag is a goal with a heading: shown, dropped by Escape, sent by Enter. The robot arrives there.
    browser.click("#fit");
    let from = in_window(&browser, 0.88, 0.09);
    let to = [from[0], from[1] - 60.0];
    browser.drag(from, to);
    browser.until("the draft shows", SOON, "!document.getElementById('draft').hidden");
    browser.key(ESCAPE);
    browser.until(
        "the draft is dropped",
        SOON,
        "document.getElementById('draft').hidden && !zenav.tools.draft",
    );
    browser.drag(from, to);
    shoot("goal_drawn");
    browser.key(ENTER);
    browser.until("the goal runs", SOON, "zenav.store.runningGoal()");
    browser.until(
        "the plan is drawn",
        SOON,
        &format!("zenav.store.data('plan') && {STATE}.mode === 'follow'"),
    );
    browser.until("it is under way", DRIVE, "zenav.store.trail.length > 12");
    shoot("driving");
    browser.until(
        "the goal is reached",
        DRIVE,
        "[...zenav.store.goals.values()].some((goal) => goal.state === 'Succeeded')",
    );
    let pose = browser.script("return zenav.store.data('pose')");
    let off = (number(&pose["x"]) - 0.88).hypot(number(&pose["y"]) - 0.09);
    assert!(off < 0.3, "{off} m from the goal: {pose}");
    assert!(
        (number(&pose["yaw"]) - 1.571).abs() < 0.3,
        "the heading that was drawn: {pose}"
    );
    shoot("arrived");

    // Stop stops, and stays until it is resumed on purpose.
    let _ = browser.script("document.getElementById('place').value = 'corner'");
    browser.click("#go-place");
    browser.until("it drives", DRIVE, "Math.abs(zenav.store.data('pose').v) > 0.1");
    browser.click("#stop");
    browser.until(
        "it is stopped",
        SOON,
        &format!("{STATE}.mode === 'stopped' && Math.abs({STATE}.velocity.v) < 0.02"),
    );
    browser.until(
        "the page says so",
        SOON,
        "document.getElementById('banner').innerText.includes('stopped')",
    );
    shoot("stopped");
    browser.click("#resume");
    browser.until("it asks first", SOON, "document.getElementById('dialog').open");
    shoot("resume");
    browser.click("#dialog-yes");
    browser.until("it may drive", SOON, &format!("{STATE}.mode !== 'stopped'"));
    browser.until("it drives on", DRIVE, "Math.abs(zenav.store.data('pose').v) > 0.1 || [...zenav.store.goals.values()].filter((goal) => goal.state === 'Succeeded').length > 1");

    // The other panels, the light theme, a tablet.
    for tab in ["events", "drive", "plots", "tree"] {
        browser.click(&format!("#tab-{tab}"));
        settle(&browser);
        shoot(&format!("panel_{tab}"));
    }
    browser.click("#theme");
    settle(&browser);
    shoot("other_theme");
    browser.click("#theme");
    browser.resize(820, 1180);
    settle(&browser);
    shoot("tablet");
    browser.resize(1280, 860);

    // Hand control is armed by the robot's name; a held key turns the robot, a released one leaves it at rest, and the mission gets it back.
    browser.click("#tab-drive");
    browser.click("#panel-drive button.primary");
    browser.until("it asks first", SOON, "document.getElementById('dialog').open");
    let enabled = browser.script("return !document.getElementById('dialog-yes').disabled");
    assert_eq!(enabled, false, "without its name it is not armed");
    for letter in ROBOT.chars() {
        browser.key(&letter.to_string());
    }
    browser.click("#dialog-yes");
    browser.until("it is armed", SOON, "zenav.store.teleop.state === 'armed'");
    browser.until(
        "the operator commands",
        SOON,
        &format!("{STATE}.lease.role === 'operator' && {STATE}.lease.live"),
    );
    let rest = format!("Math.abs({STATE}.velocity.w) < 0.02 && Math.abs({STATE}.velocity.v) < 0.02");
    browser.until("it rests", SOON, &rest);
    let yaw = || number(&browser.script("return zenav.store.data('pose').yaw"));
    let before = yaw();
    browser.hold("a", Duration::from_millis(600));
    browser.until("it rests again", SOON, &rest);
    let turned = (yaw() - before).rem_euclid(std::f64::consts::TAU);
    assert!((0.1..5.0).contains(&turned), "a held key turned it by {turned} rad");
    shoot("armed");
    browser.click("#panel-drive > button");
    browser.until(
        "the mission commands again",
        SOON,
        &format!("{STATE}.lease.role === 'mission' && {STATE}.lease.live"),
    );

    // Without the cloud the badge turns, and a stop works all the same.
    cloud.kill();
    browser.until(
        "the badge turns",
        SOON,
        "document.querySelector('[data-id=link]').innerText.includes('cloud lost')",
    );
    shoot("cloud_lost");
    browser.click("#stop");
    browser.until(
        "it is stopped without a cloud",
        SOON,
        &format!("{STATE}.mode === 'stopped'"),
    );

    // Without the gateway the page says so, and is back by itself.
    gateway.kill();
    browser.until(
        "the page says that the gateway is gone",
        SOON,
        "document.getElementById('banner').innerText.includes('Gateway lost')",
    );
    let label = browser.script("return document.getElementById('stop').innerText");
    assert_eq!(label, "STOP", "what is old says nothing about now");
    shoot("gateway_lost");
    let before = browser.errors();
    let (_gateway, _) = start_gateway(&deployment, &listen);
    browser.until(
        "the page is back",
        SOON,
        &format!("zenav.store.socket === 'open' && {STATE}?.mode === 'stopped'"),
    );
    let thrown: Vec<String> = before
        .into_iter()
        .filter(|line| line.contains("Uncaught") || line.contains("Error:"))
        .collect();
    assert!(thrown.is_empty(), "{thrown:#?}");
}
