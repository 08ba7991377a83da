//! Does the page understand fingers, keys and screens, and does it insist on a stop while its link is lost?

use serde_json::{Value, json};

use crate::site::{ENTER, SOON, STATE, Site, my_turn, number, start_gateway};

/// Fingers on the window, pixels: `touchStart`, `touchMove` or `touchEnd`.
fn fingers(site: &Site, what: &str, places: &[[f64; 2]]) {
    let points: Vec<Value> = (0..)
        .zip(places)
        .map(|(id, [x, y])| json!({ "id": id, "x": x, "y": y }))
        .collect();
    let event = json!({ "type": what, "touchPoints": points });
    site.browser.command("Input.dispatchTouchEvent", &event);
}

/// A finger touches a map position for a moment.
fn tap(site: &Site, place: [f64; 2]) {
    fingers(site, "touchStart", &[site.in_window(place)]);
    fingers(site, "touchEnd", &[]);
}

/// One finger, then two touch the map, and spread.
fn spread(site: &Site) {
    let [x, y] = site.in_window([0.0, 0.0]);
    fingers(site, "touchStart", &[[x, y]]);
    fingers(site, "touchStart", &[[x, y], [x - 80.0, y]]);
    fingers(site, "touchMove", &[[x + 60.0, y], [x - 140.0, y]]);
    fingers(site, "touchEnd", &[]);
}

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn a_finger_is_asked_before_the_robot_goes_and_two_fingers_only_move_the_map() {
    let _turn = my_turn();
    let site = Site::open();
    let page = &site.browser;
    let touch = json!({ "enabled": true, "maxTouchPoints": 2 });
    page.command("Emulation.setTouchEmulationEnabled", &touch);
    tap(&site, [0.5, -0.6]);
    page.until("it asks first", SOON, "!document.getElementById('draft').hidden");
    let scale = || number(&page.script("return zenav.view.camera.scale"));
    let (before, place) = (scale(), page.script("return zenav.tools.draft.x"));
    spread(&site);
    assert!(scale() > 1.3 * before, "{before} {}", scale());
    assert_eq!(
        page.script("return zenav.tools.draft?.x"),
        place,
        "the goal is still there"
    );
    assert_eq!(page.script("return zenav.store.goals.size"), 0, "nothing was sent");
    page.click("#draft-cancel");

    page.click("#fit");
    page.click("#tool-zone");
    for corner in [[0.9, -1.0], [1.3, -1.0], [1.3, -1.4]] {
        tap(&site, corner);
    }
    let corners = "return zenav.tools.draft?.points.length";
    assert_eq!(page.script(corners), 3);
    spread(&site);
    assert_eq!(page.script(corners), 3, "no corner was added, and none is lost");

    // A window that moves to a finer screen keeps its size.
    let finer = json!({ "width": 1280, "height": 860, "deviceScaleFactor": 2, "mobile": false });
    page.command("Emulation.setDeviceMetricsOverride", &finer);
    page.until(
        "the map is drawn as finely as the screen shows it",
        SOON,
        "devicePixelRatio === 2 && document.getElementById('map').width === 2 * document.getElementById('map').clientWidth",
    );
    let thrown = site.thrown();
    assert!(thrown.is_empty(), "{thrown:#?}");
}

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn what_is_typed_is_what_is_sent_and_a_name_is_never_markup() {
    let _turn = my_turn();
    let site = Site::open();
    let page = &site.browser;
    let _ = page.script("document.querySelector('#goals details').open = true");
    for (field, number) in [("#goal-x", "0.88"), ("#goal-y", "0.09")] {
        page.click(field);
        site.write(number);
    }
    page.key(ENTER);
    page.until(
        "the goal is at the coordinates, not at the place in the list above",
        SOON,
        "[...zenav.store.goals.values()].some((goal) => goal.request.x === 0.88 && goal.request.y === 0.09 && !goal.request.place)",
    );
    let read = page.script_async(
        "const done = arguments[0]; import('/page/polygon.js').then(({ cornersOf }) => done(['0.2, -1, 0.8, -1, 0.8, -0.4', '0,2 -1; 0,8 -1; 0,8 -0,4', '1 2 3 4'].map(cornersOf)));",
    );
    assert_eq!(
        read,
        json!([[[0.2, -1], [0.8, -1], [0.8, -0.4]], null, null]),
        "decimal commas make no other corners"
    );
    let name = "<img src=x onerror=zenav.broken=1>";
    let saved = page.script_async(&format!(
        "const done = arguments[0]; import('/page/api.js').then((api) => api.putPlace('tiago', '{name}', {{ x: 0.5, y: -0.5 }})).then(() => done(true));"
    ));
    assert_eq!(saved, true);
    page.click("#tab-map");
    page.until(
        "the name is listed",
        SOON,
        &format!("document.getElementById('places').textContent.includes('{name}')"),
    );
    let markup = page.script("return document.querySelectorAll('#panels img, #panels script').length");
    assert_eq!(
        (markup, page.script("return zenav.broken ?? null")),
        (json!(0), Value::Null)
    );
    // What a browser kept for the page, and its address, may be anything.
    let _ = page.script("localStorage.setItem('zenav-layers', '{{'); localStorage.setItem('zenav-plots', '7')");
    page.go(&format!("http://{}/?again#token=%", site.listen));
    let is_there = format!("{STATE} && !location.hash");
    page.until("the page is there all the same", SOON, &is_there);
    let thrown = site.thrown();
    assert!(thrown.is_empty(), "{thrown:#?}");
}

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn a_stop_is_asked_for_until_the_link_is_back_and_what_was_seen_is_not_news() {
    let _turn = my_turn();
    let mut site = Site::open();
    let link = |is_up: bool| {
        let rate = if is_up { -1 } else { 0 };
        json!({ "offline": !is_up, "latency": 0, "downloadThroughput": rate, "uploadThroughput": rate })
    };
    site.browser.command("Network.enable", &json!({}));
    site.browser.command("Network.emulateNetworkConditions", &link(false));
    site.browser.click("#stop");
    site.browser.until(
        "the page says that it is not confirmed",
        SOON,
        "document.getElementById('toasts').innerText.includes('STOP NOT CONFIRMED')",
    );
    site.browser.command("Network.emulateNetworkConditions", &link(true));
    site.browser
        .until("it is stopped", SOON, &format!("{STATE}?.mode === 'stopped'"));

    // The stop is an error among the events: it is news until it was on the screen, and a gateway that starts again tells it again.
    let stopped = "zenav.store.events.some((event) => event.event === 'stopped')";
    let count = "document.querySelector('#tab-events .count')";
    site.browser
        .until("it is news", SOON, &format!("{stopped} && !{count}.hidden"));
    site.browser.click("#tab-events");
    site.browser.click("#tab-tree");
    site.browser
        .until("it is not any more", SOON, &format!("{count}.hidden"));
    site.gateway.kill();
    site.browser
        .until("the gateway is gone", SOON, "zenav.store.socket === 'closed'");
    let (_gateway, _) = start_gateway(
        site.deployment.folder(),
        &site.deployment.router,
        &["--listen", &site.listen],
    );
    site.browser.until(
        "it is told again",
        SOON,
        &format!("zenav.store.socket === 'open' && {stopped}"),
    );
    let is_hidden = site.browser.script(&format!("return {count}.hidden"));
    assert_eq!(is_hidden, true, "it was seen");
}
