//! Twenty robots at 10 Hz in one browser, and browsers that do not read: is everything shown, and is anybody delayed?

use std::path::Path;
use std::time::Duration;

use tokio::runtime::Runtime;
use zenav_tests::acceptance::page::{MadeUpFleet, slow_sockets, watch};
use zenav_tests::browser::Browser;

use crate::site::{ZENAV, my_turn};

const ROBOTS: usize = 20;

fn fleet(runtime: &Runtime, folder: &Path) -> MadeUpFleet {
    let starting = MadeUpFleet::start(Path::new(ZENAV), folder, ROBOTS);
    runtime.block_on(starting).unwrap()
}

#[test]
#[ignore = "needs Chromium and chromedriver; .ci/run installs them"]
fn twenty_robots_at_10_hz_all_move_on_the_page() {
    let _turn = my_turn();
    let (folder, runtime) = (tempfile::tempdir().unwrap(), Runtime::new().unwrap());
    let fleet = fleet(&runtime, folder.path());
    let browser = Browser::open(1280, 860);
    let found = watch(&fleet, &browser, ROBOTS, Duration::from_secs(5)).unwrap();
    println!("{found:?}");
    assert_eq!(found.moving, ROBOTS as u64);
    // Cost and frame rate are measured by `acceptance page`, on an otherwise idle machine.
    assert!(found.frames_hz > 1.0 && found.drawn_hz > 1.0, "{found:?}");
}

#[test]
fn browsers_that_do_not_read_cost_little_memory_and_hold_up_nobody() {
    let (folder, runtime) = (tempfile::tempdir().unwrap(), Runtime::new().unwrap());
    let fleet = fleet(&runtime, folder.path());
    let sockets = 100;
    let keeping = slow_sockets(&fleet, sockets, Duration::from_secs(5));
    let found = runtime.block_on(keeping).unwrap();
    println!("{found:?}");
    let each = (found.most - found.before) / sockets as u64;
    assert!(each < 512 * 1024, "{each} bytes a socket: {found:?}");
}
