//! Does the robot use what a user draws on the map?

use serde_json::Value;

use crate::site::{DRIVE, ENTER, SOON, STATE, Site, my_turn, number};

/// Corners of a band across the passage on the left of the kitchen's island; the other passage stays open.
const PASSAGE: [[f64; 2]; 4] = [[-2.1, -1.6], [-0.75, -1.6], [-0.75, -2.0], [-2.1, -2.0]];

/// Sends the robot to a named place through the panel, waits for the plan, and returns its points.
fn plan_to(site: &Site, place: &str) -> Vec<[f64; 2]> {
    let before = site
        .browser
        .script("return zenav.store.data('plan')?.trajectory_id ?? 0");
    let _ = site
        .browser
        .script(&format!("document.getElementById('place').value = '{place}'"));
    site.browser.click("#go-place");
    site.browser.until(
        "a plan comes",
        DRIVE,
        &format!("zenav.store.data('plan') && zenav.store.data('plan').trajectory_id !== {before} && {STATE}.mode === 'follow'"),
    );
    let points = site.browser.script("return zenav.store.data('plan').points");
    let numbers: Vec<f64> = points.as_array().unwrap().iter().map(number).collect();
    numbers.chunks_exact(3).map(|point| [point[0], point[1]]).collect()
}

/// Whether a plan crosses the band of [`PASSAGE`].
fn is_through(plan: &[[f64; 2]]) -> bool {
    plan.iter()
        .any(|[x, y]| (-2.1..-0.75).contains(x) && (-2.0..-1.6).contains(y))
}

fn cancel(site: &Site) {
    site.browser.click("#active-goal .row button:last-child");
    site.browser
        .until("it is cancelled", SOON, "!zenav.store.runningGoal()");
    site.browser
        .until("it rests", SOON, &format!("Math.abs({STATE}.velocity.v) < 0.01"));
}

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn a_zone_drawn_bends_the_next_plan_and_places_and_pose_are_set_by_a_click() {
    let _turn = my_turn();
    // Slowly: the goal must be cancelled before the robot passes the place of the zone.
    let site = Site::open_at(1.0);
    let page = &site.browser;
    let plan = plan_to(&site, "corner");
    assert!(is_through(&plan), "the shortest way is on the left: {plan:?}");
    cancel(&site);

    // Four clicks, a click on the first corner, a name, Enter.
    page.click("#tool-zone");
    for corner in PASSAGE {
        site.click_at(corner);
    }
    site.click_at(PASSAGE[0]);
    page.until("it asks for a name", SOON, "document.activeElement.id === 'draft-name'");
    site.write("wet");
    site.shoot("zone_drawn");
    page.key(ENTER);
    page.until(
        "the zone is there",
        SOON,
        "zenav.store.zones.some((zone) => zone.name === 'wet')",
    );
    let plan = plan_to(&site, "corner");
    assert!(!is_through(&plan), "around the zone: {plan:?}");
    site.shoot("zone_bends_plan");
    cancel(&site);

    // Editing: a corner moved, the rule changed; then renamed and removed.
    page.click("#tab-map");
    page.click("#zones button");
    page.until("its corners show", SOON, "zenav.tools.draft?.original === 'wet'");
    site.drag(PASSAGE[1], [-0.9, -1.5]);
    let _ = page.script(
        "const rule = document.getElementById('draft-rule'); rule.value = 'speed_limit'; rule.dispatchEvent(new Event('change'))",
    );
    site.shoot("zone_edited");
    page.click("#draft-send");
    page.until(
        "it is another zone",
        SOON,
        "zenav.store.zones.some((zone) => zone.rule.speed_limit?.max_speed === 0.2 && Math.abs(zone.points[1][0] + 0.9) < 0.05)",
    );
    page.click("#zones button:nth-child(2)");
    page.until("it asks for the name", SOON, "document.getElementById('dialog').open");
    let _ = page.script("document.getElementById('dialog-input').value = ''");
    site.write("slow");
    page.click("#dialog-yes");
    page.until(
        "it has another name",
        SOON,
        "zenav.store.zones.length === 1 && zenav.store.zones[0].name === 'slow'",
    );
    page.click("#zones button:nth-child(3)");
    page.until("it asks first", SOON, "document.getElementById('dialog').open");
    page.click("#dialog-yes");
    page.until("it is gone", SOON, "zenav.store.zones.length === 0");

    // A place with a heading.
    page.click("#tool-place");
    site.drag([0.9, -1.0], [0.9, -0.4]);
    page.until("it asks for a name", SOON, "!document.getElementById('draft').hidden");
    page.click("#draft-name");
    site.write("tea");
    page.key(ENTER);
    page.until("the place is there", SOON, "zenav.store.places.tea");
    let place: Value = page.script("return zenav.store.places.tea");
    assert!(
        (number(&place["x"]) - 0.9).abs() < 0.05 && (number(&place["yaw"]) - 1.571).abs() < 0.1,
        "{place}"
    );

    // Setting the pose: 30 cm from the robot's own estimate.
    let pose = page.script("return zenav.store.data('pose')");
    let told = [number(&pose["x"]) + 0.3, number(&pose["y"])];
    page.click("#tool-pose");
    site.drag(told, [told[0] + 0.5, told[1]]);
    page.until(
        "it asks first",
        SOON,
        "document.getElementById('draft-text').innerText.includes('drops its plan')",
    );
    site.shoot("pose_drawn");
    page.click("#draft-send");
    page.until(
        "mapping has told the robot",
        SOON,
        "document.getElementById('toasts').innerText.includes('Pose of')",
    );
    // The resulting pose is for the `at_run_time` tests: this robot's GPS corrects it at once.
    page.until(
        "under the operator's lease",
        SOON,
        "zenav.store.events.some((event) => event.event === 'lease' && event.holder === 'gateway')",
    );
    page.until(
        "the lease is given back",
        SOON,
        &format!("{STATE}.lease.role === 'mission' && {STATE}.lease.live"),
    );
    let thrown = site.thrown();
    assert!(thrown.is_empty(), "{thrown:#?}");
}

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn goals_that_wait_are_put_in_another_order_and_cancelled() {
    let _turn = my_turn();
    let site = Site::open();
    let page = &site.browser;
    for place in ["corner", "sink", "table_5", "table_7"] {
        let _ = page.script(&format!("document.getElementById('place').value = '{place}'"));
        page.click("#go-place");
        page.until(
            "it is listed",
            SOON,
            &format!("[...zenav.store.goals.values()].some((goal) => goal.request.place === '{place}')"),
        );
        if place == "corner" {
            page.until("it runs", SOON, "zenav.store.runningGoal()?.state === 'Active'");
            page.click("#active-goal .pause");
            page.until("it is paused", SOON, "zenav.store.runningGoal()?.state === 'Paused'");
        }
    }
    let order = |wanted: &str| {
        page.until(
            &format!("the order {wanted}"),
            SOON,
            &format!("[...document.querySelectorAll('#goal-list .waits > span:nth-child(2)')].map((row) => row.firstChild.data).join() === '{wanted}'"),
        );
    };
    order("sink,table_5,table_7");
    page.click("#goal-list li:nth-child(3) button[title=Earlier]");
    order("sink,table_7,table_5");
    assert_eq!(
        page.script("return document.activeElement.getAttribute('aria-label')"),
        "Earlier: goal table_7",
        "the list is another one, and the focus still there"
    );
    page.click("#goal-list li:nth-child(1) button[title=Later]");
    order("table_7,sink,table_5");
    site.shoot("queue");
    page.click("#goal-list li:nth-child(2) button[title=Cancel]");
    order("table_7,table_5");
    page.click("#active-goal .row button:last-child");
    page.until(
        "the first of the queue runs",
        SOON,
        "zenav.store.runningGoal()?.request.place === 'table_7'",
    );
    let thrown = site.thrown();
    assert!(thrown.is_empty(), "{thrown:#?}");
}
