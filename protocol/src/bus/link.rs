//! Link. Is a component linked to a router? Changes update its readiness, its log (`router lost`, `router back`) and the metrics.

use std::collections::BTreeMap;

use zenav_observability::metrics::{ROUTER_LINKED, ROUTER_LINKS, ROUTER_RECONNECTS};
use zenav_observability::{Condition, Readiness};
use zenoh::config::WhatAmI;
use zenoh::sample::SampleKind;
use zenoh::session::TransportEvent;
use zenoh::{Session, Wait};

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

/// Reports changes of a session's links while it is open, without keeping the session open.
fn watch(session: &Session, mut told: impl FnMut(&Links) + Send + Sync + 'static) {
    let mut links = Links::default();
    let watched = session
        .info()
        .transport_events_listener()
        .history(true)
        .callback_mut(move |event: TransportEvent| {
            links.change(&event);
            told(&links);
        })
        .background()
        .wait();
    if let Err(error) = watched {
        tracing::warn!(%error, "the links of a session are not watched");
    }
}

/// Reports a component's link to its routers.
pub(super) fn watch_routers(session: &Session, part: &Readiness, linked: Condition) {
    let name = part.name().to_owned();
    let gauge = ROUTER_LINKED.with_label_values(&[&name]);
    let reconnects = ROUTER_RECONNECTS.with_label_values(&[&name]);
    // `None` before the first link, which readiness reports.
    let mut was_linked = None;
    watch(session, move |links| {
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
    watch(session, move |links| {
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
