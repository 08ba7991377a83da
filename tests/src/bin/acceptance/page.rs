//! The page under load. The gateway's cost with many robots, and with many browsers that do not read.

use std::time::Duration;

use tokio::runtime::Runtime;
use zenav_fixtures::Row;
use zenav_tests::acceptance::page::{MadeUpFleet, slow_sockets as keep_slow, watch};
use zenav_tests::browser::Browser;

use crate::{Verdict, zenav};

/// Largest share of a core for the gateway with twenty robots.
const AFFORDABLE: f64 = 0.30;
/// Least rate of animation frames in the page, 1/s. The browser offers 60; the page draws only in frames in which something moved.
const SMOOTH: f64 = 55.0;
/// Largest memory cost of a socket that does not read, bytes.
const SOCKET: f64 = 256.0 * 1024.0;

/// Shows a number of robots in a browser.
pub fn page(robots: usize, secs: u64) -> Verdict {
    let folder = tempfile::tempdir()?;
    let runtime = Runtime::new()?;
    let fleet = runtime.block_on(MadeUpFleet::start(&zenav(), folder.path(), robots))?;
    let browser = Browser::open(1280, 860);
    let found = watch(&fleet, &browser, robots, Duration::from_secs(secs))?;
    for (name, value, unit) in [
        ("gateway", 100.0 * found.core, "% of a core"),
        ("frames of data", found.frames_hz, "Hz"),
        ("pictures drawn", found.drawn_hz, "Hz"),
        ("screen frames", found.screen_hz, "Hz"),
    ] {
        println!("{name:36} {value:8.1} {unit}");
        Row::new(format!("page, {robots} robots: {name}"), value, unit).print();
    }
    Ok(found.moving == robots as u64 && found.core <= AFFORDABLE && found.screen_hz >= SMOOTH)
}

/// Keeps a number of sockets open that never read.
pub fn slow_sockets(sockets: usize, secs: u64) -> Verdict {
    let folder = tempfile::tempdir()?;
    let runtime = Runtime::new()?;
    let fleet = runtime.block_on(MadeUpFleet::start(&zenav(), folder.path(), 20))?;
    let found = runtime.block_on(keep_slow(&fleet, sockets, Duration::from_secs(secs)))?;
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    for (name, value, unit) in [
        ("memory before", mib(found.before), "MiB"),
        ("memory, most", mib(found.most), "MiB"),
        ("memory in the end", mib(found.last), "MiB"),
        ("closed by the gateway", found.closed as f64, ""),
        ("longest answer to another request", 1e3 * found.answer, "ms"),
    ] {
        println!("{name:36} {value:8.1} {unit}");
        Row::new(format!("{sockets} slow sockets: {name}"), value, unit).print();
    }
    Ok((found.most - found.before) as f64 <= SOCKET * sockets as f64)
}
