//! Can a user see the robot, send it, stop it and drive it by hand, and does the page report a lost cloud or gateway?

use std::time::Duration;

use zenav_tests::deployment::ROBOT;

use crate::site::{DRIVE, ESCAPE, SOON, STATE, Site, my_turn, number, start_gateway, until};

/// Number of pixels of the map that show wall, free floor and scan, in a sample of every third pixel.
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
    let _turn = my_turn();
    let mut site = Site::open();

    // The map is drawn, with the scan over it.
    until("walls, floor and scan are drawn", SOON, || {
        let counts = site.browser.script(PIXELS);
        number(&counts[0]) > 300.0 && number(&counts[1]) > 5000.0 && number(&counts[2]) > 30.0
    });

    // A drag makes a goal with a heading, sent as soon as the drag ends. The robot arrives there.
    let from = site.in_window([0.88, 0.09]);
    let to = [from[0], from[1] - 60.0];
    site.browser.drag(from, to);
    site.browser.until("the goal runs", SOON, "zenav.store.runningGoal()");
    // For a second goal the page asks first; Escape drops it without any change.
    site.click_at([-1.3, -1.1]);
    site.browser
        .until("the draft shows", SOON, "!document.getElementById('draft').hidden");
    site.shoot("goal_drawn");
    site.browser.key(ESCAPE);
    site.browser.until(
        "the draft is dropped",
        SOON,
        "document.getElementById('draft').hidden && !zenav.tools.draft && zenav.store.goals.size === 1",
    );
    site.browser.until(
        "the plan is drawn",
        SOON,
        &format!("zenav.store.data('plan') && {STATE}.mode === 'follow'"),
    );
    site.browser
        .until("it is under way", DRIVE, "zenav.store.trail.length > 12");
    site.shoot("driving");
    let fits = "const badges = document.getElementById('badges'); return badges.scrollWidth <= badges.clientWidth";
    assert_eq!(site.browser.script(fits), true, "no badge is cut off");
    site.browser.key("?");
    site.browser
        .until("the keys are listed", SOON, "!document.getElementById('help').hidden");
    site.browser.key(ESCAPE);
    site.browser.until(
        "the list is closed, also for screen readers",
        SOON,
        "document.getElementById('help').hidden && document.getElementById('help-button').ariaExpanded === 'false'",
    );
    site.browser.until(
        "the goal is reached",
        DRIVE,
        "[...zenav.store.goals.values()].some((goal) => goal.state === 'Succeeded')",
    );
    let pose = site.browser.script("return zenav.store.data('pose')");
    let off = (number(&pose["x"]) - 0.88).hypot(number(&pose["y"]) - 0.09);
    assert!(off < 0.3, "{off} m from the goal: {pose}");
    assert!(
        (number(&pose["yaw"]) - 1.571).abs() < 0.3,
        "the heading that was drawn: {pose}"
    );
    site.shoot("arrived");

    // Stop takes effect, and lasts until it is resumed deliberately.
    let _ = site.browser.script("document.getElementById('place').value = 'corner'");
    site.browser.click("#go-place");
    site.browser
        .until("it drives", DRIVE, "Math.abs(zenav.store.data('pose').v) > 0.1");
    site.browser.click("#stop");
    site.browser.until(
        "it is stopped",
        SOON,
        &format!("{STATE}.mode === 'stopped' && Math.abs({STATE}.velocity.v) < 0.02"),
    );
    site.browser.until(
        "the page says so",
        SOON,
        "document.getElementById('banner').innerText.includes('stopped')",
    );
    site.shoot("stopped");
    site.browser.click("#resume");
    site.browser
        .until("it asks first", SOON, "document.getElementById('dialog').open");
    site.shoot("resume");
    site.browser.click("#dialog-yes");
    site.browser
        .until("it may drive", SOON, &format!("{STATE}.mode !== 'stopped'"));
    site.browser.until("it drives on", DRIVE, "Math.abs(zenav.store.data('pose').v) > 0.1 || [...zenav.store.goals.values()].filter((goal) => goal.state === 'Succeeded').length > 1");

    // The other panels, the light theme, a tablet.
    for tab in ["events", "drive", "plots", "tree"] {
        site.browser.click(&format!("#tab-{tab}"));
        site.settle();
        site.shoot(&format!("panel_{tab}"));
    }
    let events = site
        .browser
        .script("return document.getElementById('events').textContent");
    let events = events.as_str().unwrap_or_default();
    assert!(events.contains("plan accepted for corner"), "{events}");
    site.browser.click("#theme");
    site.settle();
    site.shoot("other_theme");
    site.browser.click("#theme");
    site.browser.resize(820, 1180);
    site.settle();
    site.shoot("tablet");
    site.browser.resize(1280, 860);

    // Hand control is armed by the robot's name; a held key turns the robot, a released one leaves it at rest, and the mission gets
    // control back.
    site.browser.click("#tab-drive");
    site.browser.click("#panel-drive button.primary");
    site.browser
        .until("it asks first", SOON, "document.getElementById('dialog').open");
    let enabled = site
        .browser
        .script("return !document.getElementById('dialog-yes').disabled");
    assert_eq!(enabled, false, "without its name it is not armed");
    site.write(ROBOT);
    site.browser.click("#dialog-yes");
    site.browser
        .until("it is armed", SOON, "zenav.store.teleop.state === 'armed'");
    site.browser.until(
        "the operator commands",
        SOON,
        &format!("{STATE}.lease.role === 'operator' && {STATE}.lease.live"),
    );
    let rest = format!("Math.abs({STATE}.velocity.w) < 0.02 && Math.abs({STATE}.velocity.v) < 0.02");
    site.browser.until("it rests", SOON, &rest);
    let yaw = || number(&site.browser.script("return zenav.store.data('pose').yaw"));
    let before = yaw();
    site.browser.hold("a", Duration::from_millis(600));
    site.browser.until("it rests again", SOON, &rest);
    let turned = (yaw() - before).rem_euclid(std::f64::consts::TAU);
    assert!((0.1..5.0).contains(&turned), "a held key turned it by {turned} rad");
    site.shoot("armed");
    site.browser.click("#panel-drive > button");
    site.browser.until(
        "the mission commands again",
        SOON,
        &format!("{STATE}.lease.role === 'mission' && {STATE}.lease.live"),
    );

    // Without the cloud the badge changes, and a stop still works.
    site.cloud.kill();
    site.browser.until(
        "the badge turns",
        SOON,
        "document.querySelector('[data-id=link]').innerText.includes('cloud lost')",
    );
    site.browser.until(
        "the map is told to be old",
        SOON,
        "document.querySelector('[data-id=map]')?.innerText.startsWith('map from ')",
    );
    site.shoot("cloud_lost");
    site.browser.click("#stop");
    site.browser.until(
        "it is stopped without a cloud",
        SOON,
        &format!("{STATE}.mode === 'stopped'"),
    );

    // Without the gateway the page says so, and it recovers by itself.
    site.gateway.kill();
    site.browser.until(
        "the page says that the gateway is gone",
        SOON,
        "/Gateway lost.* Last state: \\d+ s ago/.test(document.getElementById('banner').innerText)",
    );
    let label = site.browser.script("return document.getElementById('stop').innerText");
    assert_eq!(label, "STOP", "what is old says nothing about now");
    site.shoot("gateway_lost");
    let thrown = site.thrown();
    let (_gateway, _) = start_gateway(
        site.deployment.folder(),
        &site.deployment.router,
        &["--listen", &site.listen],
    );
    site.browser.until(
        "the page is back",
        SOON,
        &format!("zenav.store.socket === 'open' && {STATE}?.mode === 'stopped'"),
    );
    assert!(thrown.is_empty(), "{thrown:#?}");
}
