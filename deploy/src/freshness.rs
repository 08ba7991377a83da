//! Freshness. How old is what a watching command shows, and is its router still there?

use std::time::{Duration, Instant};

use zenav_protocol::bus::Bus;

/// Age from which the newest message counts as old.
pub(crate) const OLD: Duration = Duration::from_secs(2);

/// Arrivals of the newest pose of a robot and of the newest status of its mission.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Heard {
    pub(crate) pose: Option<Instant>,
    pub(crate) mission: Option<Instant>,
}

/// Time since each of [`Heard`]; `None` before the first.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Ages {
    pub(crate) pose: Option<Duration>,
    pub(crate) mission: Option<Duration>,
}

impl Heard {
    pub(crate) fn ages(&self) -> Ages {
        Ages {
            pose: self.pose.map(|at| at.elapsed()),
            mission: self.mission.map(|at| at.elapsed()),
        }
    }
}

impl Ages {
    /// Whether one of the two came once and is old now.
    pub(crate) fn is_old(&self) -> bool {
        [self.pose, self.mission].into_iter().any(is_old)
    }

    /// For a status line.
    pub(crate) fn text(&self) -> String {
        let told = |what: &str, age: Option<Duration>| match age {
            Some(age) if age < Duration::from_secs(10) => format!("{what} {:.1} s old", age.as_secs_f64()),
            Some(age) => format!("{what} {} s old", age.as_secs()),
            None => format!("no {what} yet"),
        };
        format!("{}, {}", told("pose", self.pose), told("mission", self.mission))
    }
}

/// Whether a message came once and is old now.
pub(crate) fn is_old(age: Option<Duration>) -> bool {
    age.is_some_and(|age| age > OLD)
}

/// Text in faint letters, on a terminal with colours.
pub(crate) fn dimmed(text: &str, colors: bool) -> String {
    if colors {
        format!("\x1b[2m{text}\x1b[0m")
    } else {
        text.to_owned()
    }
}

/// The link of a watching command to its router.
#[derive(Debug)]
pub(crate) struct RouterLink {
    bus: Bus,
    is_linked: bool,
}

impl RouterLink {
    /// The link of a command that is connected.
    pub(crate) fn new(bus: &Bus) -> Self {
        Self {
            bus: bus.clone(),
            is_linked: true,
        }
    }

    /// Tells once that the router was lost, and once that it is back.
    pub(crate) async fn news(&mut self) -> Option<&'static str> {
        let is_linked = self.bus.is_connected().await;
        if std::mem::replace(&mut self.is_linked, is_linked) == is_linked {
            return None;
        }
        Some(if is_linked {
            "zenav: router back"
        } else {
            "zenav: router lost"
        })
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::bus::{BusConfig, Router, RouterConfig};

    use super::*;

    #[test]
    fn the_ages_tell_what_is_missing() {
        let secs = Duration::from_secs_f64;
        let ages = Ages {
            pose: Some(secs(0.34)),
            mission: None,
        };
        assert_eq!(ages.text(), "pose 0.3 s old, no mission yet");
        assert!(!ages.is_old());
        let ages = Ages {
            mission: Some(secs(12.7)),
            ..ages
        };
        assert_eq!(ages.text(), "pose 0.3 s old, mission 12 s old");
        assert!(ages.is_old());
    }

    /// Repeats an attempt until it yields something.
    async fn until<T>(what: &str, mut attempt: impl AsyncFnMut() -> Option<T>) -> T {
        let mut pace = tokio::time::interval(Duration::from_millis(20));
        let found = async {
            loop {
                pace.tick().await;
                if let Some(found) = attempt().await {
                    return found;
                }
            }
        };
        tokio::time::timeout(Duration::from_secs(30), found).await.expect(what)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_router_that_goes_and_comes_back_is_told_once_each_time() {
        let mut config = RouterConfig {
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            ..RouterConfig::default()
        };
        let router = Router::open(&config).await.unwrap();
        let endpoint = router.endpoints().await.remove(0);
        let bus = Bus::open(BusConfig::command("watch", &endpoint)).await.unwrap();
        let mut link = RouterLink::new(&bus);
        assert_eq!(link.news().await, None);
        router.close().await;
        let news = until("the loss", async || link.news().await).await;
        assert_eq!(news, "zenav: router lost");
        assert_eq!(link.news().await, None);
        config.listen = vec![endpoint];
        let _router = until("the port is free again", async || Router::open(&config).await.ok()).await;
        let news = until("the return", async || link.news().await).await;
        assert_eq!(news, "zenav: router back");
    }
}
