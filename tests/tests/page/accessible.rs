//! Is the page accessible? Checked by axe's rules in every panel, in both themes, and at the sizes of a screen and a tablet.

use serde_json::Value;
use zenav_tests::browser::Browser;

use crate::site::{Site, my_turn};

/// Findings of axe, one per line.
fn findings(page: &Browser, axe: &str, place: &str) -> Vec<String> {
    let _ = page.script(&format!("{axe}; window.axe = axe"));
    let found =
        page.script_async("const done = arguments[0]; axe.run(document).then((result) => done(result.violations));");
    let line = |finding: &Value| {
        let nodes = finding["nodes"].as_array().into_iter().flatten();
        let nodes: Vec<String> = nodes.map(|node| node["html"].to_string()).collect();
        format!(
            "{place}: {} {}: {}",
            finding["impact"],
            finding["help"],
            nodes.join(" ")
        )
    };
    found.as_array().unwrap().iter().map(line).collect()
}

#[test]
#[ignore = "needs Chromium, chromedriver and `AXE=axe.min.js`; .ci/run installs them"]
fn axe_finds_nothing_in_any_panel_theme_or_size() {
    let _turn = my_turn();
    let file = std::env::var("AXE").expect("AXE: the path of axe.min.js");
    let axe = std::fs::read_to_string(file).unwrap();
    let site = Site::open();
    let (page, mut found) = (&site.browser, Vec::new());
    for theme in ["one theme", "the other"] {
        for tab in ["tree", "events", "map", "drive", "plots"] {
            page.click(&format!("#tab-{tab}"));
            site.settle();
            found.extend(findings(page, &axe, &format!("{tab}, {theme}")));
        }
        page.click("#layers-button");
        page.click("#tool-zone");
        for corner in [[0.0, -0.2], [0.5, -0.2], [0.5, -0.7], [0.0, -0.2]] {
            site.click_at(corner);
        }
        found.extend(findings(page, &axe, &format!("a zone is drawn, layers show, {theme}")));
        page.click("#draft-cancel");
        page.click("#help-button");
        found.extend(findings(page, &axe, &format!("the keys are listed, {theme}")));
        page.click("#help-button");
        page.click("#theme");
    }
    page.resize(820, 1180);
    site.settle();
    found.extend(findings(page, &axe, "tablet"));
    site.shoot("tablet_map");
    assert!(found.is_empty(), "{found:#?}");
}
