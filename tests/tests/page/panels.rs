//! Does every layer of the map show what its name says, and do the panels tell what runs, what failed, and the robot's numbers?

use serde_json::json;
use zenav_tests::deployment::ROBOT;

use crate::site::{ENTER, ESCAPE, SOON, STATE, Site, my_turn, number, start_gateway};

/// Draws made-up messages around a free position. Answers for each layer how many bytes of the picture there its switch changes, and how many
/// stay changed once it is off again; for `old …` how many the age of the data changes.
const LAYERS: &str = r#"
    const done = arguments[0];
    (async () => {
      const { store, view } = zenav;
      const [x, y] = [0.3, -0.4];
      const line = [x - 0.5, y, x + 0.5, y];
      const points = Array.from({ length: 21 }, (_, at) => [x - 0.5 + at * 0.05, y]);
      const told = {
        tree: { edges: line, path: line },
        graph: { nodes: line, odometry: [], closures: [0, 1], rejected: [], certificate: "pending" },
        "marker/made-up": { name: "made-up", points: [[x - 0.5, y], [x + 0.5, y]] },
        obstacles: [[x, y, 0.1, 0, 0.2]],
        plan: { trajectory_id: -1, points: points.flatMap(([px, py]) => [px, py, 0.4]), yaws: points.map(() => 0), min_clearance: 0.3, corridor_width: 0.5 },
        corridor: { trajectory_id: -1, polygons: [[x - 0.5, y - 0.4, x + 0.5, y - 0.4, x + 0.5, y, x - 0.5, y]] },
      };
      // The robot's own messages of these names must not replace them, nor may they age while the page draws.
      const frame = store.frame;
      store.frame = (message) => {
        for (const name of Object.keys(told)) delete message.detail?.[name];
        frame.call(store, message);
      };
      const tell = () => {
        const heard = performance.now() / 1000 + 60;
        for (const [name, data] of Object.entries(told)) store.detail.set(name, { data, heard });
        store.goals.set("made-up", { id: "made-up", state: "Accepted", request: { x, y } });
        store.trail.push(null, ...points);
        const annotations = store.data("annotations");
        annotations.places["made-up"] = { x, y };
        annotations.zones = [{ name: "made-up", rule: "keep_out", points: [[x - 0.3, y - 0.3], [x + 0.3, y - 0.3], [x, y + 0.3]] }];
        if (!store.fleet.includes("other")) store.fleet.push("other");
        store.robots.set("other", { pose: { data: { x, y, yaw: 0, v: 0, w: 0 }, heard } });
      };
      const scan = store.data("scan");
      const beam = scan.mm.findIndex((mm) => mm > 0);
      const [angle, range] = [scan.at[2] + scan.first + beam * scan.step, scan.mm[beam] / 1000];
      const places = { scan: [scan.at[0] + range * Math.cos(angle), scan.at[1] + range * Math.sin(angle)], grid: [0, y] };
      const picture = async (layer) => {
        await new Promise((drawn) => { requestAnimationFrame(() => requestAnimationFrame(drawn)); });
        const [px, py] = view.camera.toScreen(...places[layer] ?? [x, y]).map((pixel) => Math.round(pixel) - 12);
        return document.getElementById("map").getContext("2d").getImageData(px, py, 24, 24).data;
      };
      const differ = (a, b) => a.filter((value, at) => Math.abs(value - b[at]) > 6).length;
      const turn = (layer) => document.getElementById(`layer-${layer}`).click();
      for (const [layer, { on }] of Object.entries(view.layers)) if (on) turn(layer);
      const found = {};
      for (const layer of Object.keys(view.layers)) {
        tell();
        const without = await picture(layer);
        turn(layer);
        const shown = await picture(layer);
        turn(layer);
        found[layer] = [differ(without, shown), differ(without, await picture(layer))];
      }
      for (const [layer, isOld] of [["plan", "isStale"], ["corridor", "isStale"], ["swath", "isStale"], ["map", "isMapOld"], ["clearance", "isMapOld"]]) {
        turn(layer);
        tell();
        const fresh = await picture(layer);
        store[isOld] = () => true;
        view.redraw();
        found[`old ${layer}`] = [differ(fresh, await picture(layer)), 0];
        delete store[isOld];
        turn(layer);
      }
      return found;
    })().then(done, (error) => done(String(error)));"#;

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn each_layer_draws_what_its_name_says_and_its_switch_hides_it() {
    let _turn = my_turn();
    let site = Site::open();
    let page = &site.browser;

    // Measure, scale, follow, and the whole map again.
    page.click("#tool-measure");
    site.drag([0.0, -0.4], [1.0, -0.4]);
    let measured =
        page.script("const [from, to] = zenav.tools.measure; return Math.hypot(to[0] - from[0], to[1] - from[1])");
    assert!((number(&measured) - 1.0).abs() < 0.03, "{measured}");
    page.click("#tool-goal");
    let bar = page.script("const bar = document.getElementById('scale'); return [bar.innerText, bar.offsetWidth / zenav.view.camera.scale]");
    let length = bar[0]
        .as_str()
        .and_then(|text| text.strip_suffix(" m"))
        .map(str::parse::<f64>);
    let length = length.unwrap().unwrap();
    assert!((number(&bar[1]) / length - 1.0).abs() < 0.05, "{bar}");
    page.key("f");
    page.until(
        "the robot is in the middle",
        SOON,
        "Math.hypot(zenav.view.camera.x - zenav.store.data('pose').x, zenav.view.camera.y - zenav.store.data('pose').y) < 0.1",
    );
    page.key("0");
    let follows = page.script("return document.getElementById('follow').ariaPressed");
    assert_eq!(follows, "false", "the whole map, and not the robot");

    page.until("places are told", SOON, "zenav.store.data('annotations')");
    let found = page.script_async(LAYERS);
    let layers = found.as_object().unwrap_or_else(|| panic!("{found}"));
    assert!(layers.len() > 15, "{found}");
    for (layer, bytes) in layers {
        assert!(number(&bytes[0]) > 40.0 && number(&bytes[1]) < 1.0, "{layer}: {found}");
    }
    let _ = page.script("document.getElementById('layer-plan').click(); zenav.store.isStale = () => true");
    page.until(
        "the legend says that the plan is old",
        SOON,
        "document.getElementById('legend-plan').innerText.includes('as last heard')",
    );
    let thrown = site.thrown();
    assert!(thrown.is_empty(), "{thrown:#?}");
}

/// A tree that waits and then fails, five times, so that it runs for long with a failed node: its last node has no goal.
const FAILS: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="Fails"><RetryUntilSuccessful num_attempts="5"><Sequence>
    <Wait wait_duration="6.0"/><ComputePathToPose goal="{nothing}" path="{path}"/></Sequence></RetryUntilSuccessful></BehaviorTree></root>"#;

/// A goal that a lost gateway takes along, and that ended meanwhile; answers the notes on the screen.
const ENDS_UNSEEN: &str = r"
    const { store } = zenav;
    const known = store.goals;
    const tell = (...goals) => {
      store.goals = new Map(goals.map((goal) => [goal.id, goal]));
      store.tell('frame');
    };
    const goal = { id: 'made-up', request: { place: 'moon' } };
    tell({ ...goal, state: 'Active' });
    tell();
    tell({ ...goal, state: 'Canceled', ended: 2, reason: 'no way there' });
    store.goals = known;
    return document.getElementById('toasts').innerText;";

/// Mapping leaves, and another part 70 s later; answers the badge of the map's age.
const MAPPING_LEAVES: &str = r"(() => {
    const { store } = zenav;
    const parts = store.data('parts');
    const tell = (data, age) => store.frame({
      now: performance.now() / 1000 - store.ahead, connected: true, robots: { [store.watched]: { parts: { data, age } } },
    });
    tell(['edge', 'mission'], 70);
    tell(['edge'], 0);
    const told = document.querySelector('[data-id=map]')?.textContent;
    tell(parts, 0);
    return told;
  })()";

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn the_panels_tell_what_failed_filter_the_events_and_plot_any_number() {
    let _turn = my_turn();
    let site = Site::open();
    let page = &site.browser;
    page.until(
        "the link's badge has the round trip and its spread",
        SOON,
        "/^link \\d+ ms\\s+p95 \\d+ ms/.test(document.querySelector('[data-id=link]').innerText) \
         && document.querySelector('[data-id=link]').title.includes('% lost')",
    );

    let tree = json!(FAILS);
    let sent = page.script_async(&format!(
        "const done = arguments[0]; import('/page/api.js').then((api) => api.submitGoal('{ROBOT}', {{ id: 'fails', tree: {tree} }})).then(() => done(true));"
    ));
    assert_eq!(sent, true);
    page.click("#tree-ports");
    page.until(
        "the node that runs, and what is on its ports",
        SOON,
        "[...document.querySelectorAll('#tree li.running')].some((node) => node.innerText.includes('wait_duration'))",
    );
    page.until(
        "the node that failed keeps its result and tells why, while the tree goes on",
        SOON,
        "document.querySelector('#tree li.was-failure') && document.querySelector('#tree li.running') \
         && document.getElementById('tree-failure').innerText.includes('ComputePathToPose: the blackboard entry')",
    );
    site.shoot("tree_failed");
    page.until(
        "the end of the goal is told",
        SOON,
        "document.getElementById('toasts').innerText.includes('Goal failed')",
    );
    page.until(
        "the tree's last failure is told too, which no message about its nodes brings",
        SOON,
        "document.getElementById('tree-failure').innerText.includes('Last failure: goal tree sent with the goal: ComputePathToPose')",
    );

    let told = page.script(ENDS_UNSEEN);
    let told = told.as_str().unwrap_or_default();
    assert!(told.contains("Goal cancelled: moon: no way there"), "{told}");

    // The tree of one robot is not the last of another.
    let left = page.script_async(
        "const done = arguments[0]; import('/page/live.js').then((live) => { \
         live.watch('nobody'); done([document.getElementById('tree').children.length, document.getElementById('tree-failure').hidden]); \
         live.watch(zenav.store.fleet[0]); });",
    );
    assert_eq!(left, json!([0, true]));
    page.until(
        "its robot is shown again",
        SOON,
        &format!("{STATE} && zenav.store.detail.has('scan') && zenav.store.raster.spec && zenav.store.data('parts')"),
    );
    page.until(
        "the map's age is that of mapping's end",
        SOON,
        &format!("{MAPPING_LEAVES} === 'map from 1 min ago'"),
    );

    page.click("#tab-events");
    page.click("#event-filter");
    site.write("lease");
    page.until(
        "only events with the word",
        SOON,
        "((rows) => rows.length && rows.every((row) => row.innerText.includes('lease')))([...document.querySelectorAll('#events li')])",
    );
    let _ = page.script(
        "zenav.store.events.push({ event: 'plan_discarded', reason: 'the lease ended', stamp: 1, boot_id: 'made-up', sequence: 1 })",
    );
    page.click("#event-warn");
    page.until(
        "only warnings",
        SOON,
        "((rows) => rows.every((row) => ['warn', 'bad'].includes(row.className)) && rows.some((row) => row.innerText.includes('the lease ended')))(\
         [...document.querySelectorAll('#events li')])",
    );

    page.click("#tab-plots");
    for field in [
        "state.battery",
        "localisation.agreeing",
        "mission.queued",
        "round_trip.p95_ms",
        "pose.v",
    ] {
        page.until(
            &format!("{field} can be plotted"),
            SOON,
            &format!(
                "((list) => {{ list.blur(); list.focus(); return [...list.options].some((option) => option.value === '{field}'); }})(document.querySelector('#panel-plots select'))"
            ),
        );
    }
    let _ = page.script("document.querySelector('#panel-plots select').value = 'mission.queued'");
    page.click("#panel-plots button");
    page.until(
        "it is plotted",
        SOON,
        "document.querySelector('#panel-plots figure:last-child canvas').ariaLabel?.startsWith('mission.queued: now 0')",
    );

    // What the robot reports as out of order.
    page.until(
        "a fault is told",
        SOON,
        &format!(
            "({STATE}.faults = {{ lidar: 'front looks aside' }}, zenav.store.tell('frame'), \
             document.getElementById('banner').innerText.includes('tiago drives slowly: front looks aside'))"
        ),
    );
    page.until(
        "a stop that a restart forgets is not told to last",
        SOON,
        &format!(
            "({STATE}.mode = 'stopped', {STATE}.faults = {{ storage: 'disk full' }}, zenav.store.tell('frame'), \
             /is stopped .* a restart forgets them .disk full/.test(document.getElementById('banner').innerText))"
        ),
    );

    // On a tablet the panels lie below the map: to edit leads to it.
    page.resize(820, 1180);
    page.click("#tab-map");
    let _ = page.script("scrollTo(0, 9999)");
    page.click("#places button");
    page.until(
        "what is edited is on the screen",
        SOON,
        "((draft, header) => draft.top > header.bottom && draft.bottom < innerHeight)(\
         document.getElementById('draft').getBoundingClientRect(), document.querySelector('header').getBoundingClientRect())",
    );
    page.key(ESCAPE);
    let thrown = site.thrown();
    assert!(thrown.is_empty(), "{thrown:#?}");
}

/// A mouse button on the window, pixels: `mousePressed`, `mouseMoved` or `mouseReleased`.
fn mouse(site: &Site, what: &str, [x, y]: [f64; 2]) {
    let buttons = u8::from(what != "mouseReleased");
    let event = json!({ "type": what, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1 });
    site.browser.command("Input.dispatchMouseEvent", &event);
}

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn escape_during_a_drag_sends_nothing_and_a_robot_is_stopped_when_the_page_that_drives_it_is_lost() {
    let _turn = my_turn();
    let site = Site::open();
    let page = &site.browser;
    let from = site.in_window([0.88, 0.09]);
    let to = [from[0], from[1] - 60.0];
    mouse(&site, "mousePressed", from);
    mouse(&site, "mouseMoved", to);
    page.until(
        "the heading shows",
        SOON,
        "document.getElementById('pointer').innerText === 'heading 90°'",
    );
    page.key(ESCAPE);
    mouse(&site, "mouseReleased", to);
    site.settle();
    let left = page.script("return [zenav.tools.draft, zenav.store.isBusy()]");
    assert_eq!(left, json!([null, false]));

    page.click("#tab-drive");
    page.click("#panel-drive button.primary");
    page.until("it asks first", SOON, "document.getElementById('dialog').open");
    site.write(ROBOT);
    page.click("#dialog-yes");
    page.until("it is armed", SOON, "zenav.store.teleop.state === 'armed'");
    page.go("about:blank");
    page.go(&format!("http://{}/", site.listen));
    page.until(
        "it is stopped",
        SOON,
        &format!(
            "{STATE}?.mode === 'stopped' && zenav.store.events.some((event) => event.event === 'stopped' && event.by.includes('browser that drove was lost'))"
        ),
    );
}

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn a_gateway_with_a_token_is_not_lost_and_is_used_once_the_token_is_typed() {
    let _turn = my_turn();
    let site = Site::open();
    let (page, folder) = (&site.browser, site.deployment.folder());
    let token = "0123456789abcdef";
    std::fs::write(folder.join("token.txt"), token).unwrap();
    let more = ["--listen", "127.0.0.1:0", "--token-file", "token.txt"];
    let (_gateway, address) = start_gateway(folder, &site.deployment.router, &more);
    page.go(&address);
    page.until(
        "it says what is missing, and asks for it",
        SOON,
        "document.getElementById('dialog').open && document.getElementById('banner').innerText.includes('needs its token')",
    );
    site.write(token);
    page.key(ENTER);
    page.until("the robot is told of", SOON, STATE);
    page.until("nothing is missing", SOON, "document.getElementById('banner').hidden");
}
