//! Link. Is a component linked to a router? Changes update its readiness, its log (`router lost`, `router back`) and the metrics.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::Duration;

use tokio::runtime::{Handle, RuntimeFlavor};
use zenav_observability::metrics::{ROUTER_LINKED, ROUTER_LINKS, ROUTER_RECONNECTS};
use zenav_observability::{Condition, Readiness};
use zenoh::config::WhatAmI;
use zenoh::sample::SampleKind;
use zenoh::session::TransportEvent;
use zenoh::{Session, Wait};

/// How long Zenoh's routers may take to notice an arrival or a departure: they look at most every 0.1 s, and later on a busy machine.
///
/// An arrival within that time after a departure is mistaken for the departed router, and receives no declarations: it reads no key and
/// answers no request until another link changes. So a router that was restarted waits for as long.
pub const SETTLING: Duration = Duration::from_millis(200);

/// Peers linked to a session.
#[derive(Default)]
struct Links(BTreeMap<String, WhatAmI>);

impl Links {
    fn change(&mut self, event: &TransportEvent) {
        let transport = event.transport();
        let zid = transport.zid().to_string();
        match event.kind() {
            SampleKind::Put => self.0.insert(zid, transport.whatami()),
            SampleKind::Delete => self.0.remove(&zid),
        };
    }

    fn of(&self, kind: WhatAmI) -> usize {
        self.0.values().filter(|known| **known == kind).count()
    }
}

/// Reports changes of a session's links while it is open, without keeping the session open. `own`: what the session itself is.
fn watch(session: &Session, own: WhatAmI, told: impl FnMut(&Links) + Send + 'static) {
    let state = Mutex::new((Links::default(), told));
    let watched = session
        .info()
        .transport_events_listener()
        .history(true)
        .callback(move |event: TransportEvent| {
            if let Ok(mut state) = state.lock() {
                let (links, told) = &mut *state;
                links.change(&event);
                told(links);
            }
            let is_gone = event.kind() == SampleKind::Delete;
            if is_gone && own == WhatAmI::Router && event.transport().whatami() == WhatAmI::Router {
                settle();
            }
        })
        .background()
        .wait();
    if let Err(error) = watched {
        tracing::warn!(%error, "the links of a session are not watched");
    }
}

/// Keeps a link to a router that is gone from coming back before its departure was noticed. Both ends of several links that break at once,
/// or while a process is paused, would otherwise be back within milliseconds. Zenoh opens no link to a router while it still tells that the
/// last one is closed.
///
/// Each link waits on a thread of its own, from its own end: Zenoh notes a departure just before it tells of it, so no link can share the
/// wait of an earlier one. A thousand links wait at once if the process has [enough threads](super::threads).
fn settle() {
    let wait = || std::thread::sleep(SETTLING);
    match Handle::try_current().map(|runtime| runtime.runtime_flavor()) {
        // Other tasks of Zenoh's thread go on meanwhile.
        Ok(RuntimeFlavor::MultiThread) => tokio::task::block_in_place(wait),
        _ => wait(),
    }
}

/// Reports a component's link to its routers. `own`: what the component's session is.
pub(super) fn watch_routers(session: &Session, own: WhatAmI, part: &Readiness, linked: Condition) {
    let name = part.name().to_owned();
    let gauge = ROUTER_LINKED.with_label_values(&[&name]);
    let reconnects = ROUTER_RECONNECTS.with_label_values(&[&name]);
    // `None` before the first link, which readiness reports.
    let mut was_linked = None;
    watch(session, own, move |links| {
        let is_linked = links.of(WhatAmI::Router) > 0;
        gauge.set(f64::from(u8::from(is_linked)));
        if is_linked {
            linked.met();
        } else {
            linked.unmet();
        }
        match (was_linked, is_linked) {
            (Some(true), false) => tracing::warn!(part = name, "router lost"),
            (Some(false), true) => {
                reconnects.inc();
                tracing::info!(part = name, "router back");
            }
            _ => {}
        }
        if is_linked || was_linked.is_some() {
            was_linked = Some(is_linked);
        }
    });
}

/// Counts the links of a router.
pub(super) fn count(session: &Session) {
    let kinds = [
        (WhatAmI::Client, "client"),
        (WhatAmI::Router, "router"),
        (WhatAmI::Peer, "peer"),
    ];
    let gauges = kinds.map(|(kind, name)| (kind, ROUTER_LINKS.with_label_values(&[name])));
    for (_, gauge) in &gauges {
        gauge.set(0.0);
    }
    let mut routers = 0;
    watch(session, WhatAmI::Router, move |links| {
        for (kind, gauge) in &gauges {
            gauge.set(links.of(*kind) as f64);
        }
        let now = links.of(WhatAmI::Router);
        if now != routers {
            tracing::info!(routers = now, "links to other routers and robots");
            routers = now;
        }
    });
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::super::threads::{WAITING, WORKERS};
    use super::*;

    #[test]
    fn links_that_are_lost_at_once_wait_at_once() {
        let mut zenoh = tokio::runtime::Builder::new_multi_thread();
        let zenoh = zenoh.worker_threads(WORKERS).max_blocking_threads(WAITING).build();
        let begun = Instant::now();
        zenoh.unwrap().block_on(async {
            let links: Vec<_> = (0..2000).map(|_| tokio::spawn(async { settle() })).collect();
            for link in links {
                link.await.unwrap();
            }
        });
        // 0.3 s; with Zenoh's own number of threads 2.6 s.
        assert!(begun.elapsed() < Duration::from_secs(2), "{:?}", begun.elapsed());
    }
}
