//! Hub. How do the robots' messages reach the clients? Through one view behind a lock that is held for microseconds, and a signal.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;
use zenav_protocol::messages::GoalPoint;
use zenav_protocol::token_bucket::TokenBucket;

use crate::settings::GatewaySettings;
use crate::view::{FleetView, Update};

/// Shared by the feed of the view and its server.
#[derive(Debug)]
pub struct Hub {
    start: Instant,
    view: Mutex<FleetView>,
    rate: Mutex<TokenBucket>,
    /// Number of rounds of news.
    rounds: watch::Sender<u64>,
    /// Watched robots, with the number of watchers.
    watchers: Mutex<BTreeMap<String, usize>>,
    watched: watch::Sender<BTreeSet<String>>,
    ended: watch::Sender<bool>,
    connected: AtomicBool,
    clients: AtomicUsize,
    places: BTreeMap<String, GoalPoint>,
    settings: GatewaySettings,
}

impl Hub {
    /// A hub without robots, with named places common to all.
    #[must_use]
    pub fn new(settings: GatewaySettings, places: BTreeMap<String, GoalPoint>) -> Arc<Self> {
        Arc::new(Self {
            start: Instant::now(),
            view: Mutex::new(FleetView::new()),
            rate: Mutex::new(TokenBucket::full(
                settings.requests_hz,
                settings.requests_hz,
                Duration::ZERO,
            )),
            rounds: watch::Sender::new(0),
            watchers: Mutex::default(),
            watched: watch::Sender::new(BTreeSet::new()),
            ended: watch::Sender::new(false),
            connected: AtomicBool::new(false),
            clients: AtomicUsize::new(0),
            places,
            settings,
        })
    }

    /// Seconds of the gateway's own clock, since its start.
    #[must_use]
    pub fn now(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    /// The view, locked: hold it only for a moment.
    pub fn view(&self) -> MutexGuard<'_, FleetView> {
        self.view.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a message about a robot into the view.
    ///
    /// ```
    /// use std::collections::BTreeMap;
    /// use zenav_gateway::{GatewaySettings, Hub, Update};
    ///
    /// let hub = Hub::new(GatewaySettings::default(), BTreeMap::new());
    /// hub.take("tiago", Update::Part { component: "edge".into(), alive: true });
    /// assert!(hub.view().knows("tiago"));
    /// ```
    pub fn take(&self, robot: &str, update: Update) {
        let now = self.now();
        self.view().take(robot, update, now);
    }

    /// Announces a round of news. `connected` is whether the gateway reaches the bus.
    pub fn announce(&self, connected: bool) {
        self.connected.store(connected, Ordering::Relaxed);
        self.rounds.send_modify(|round| *round += 1);
    }

    /// The robots that are watched now.
    #[must_use]
    pub fn watched(&self) -> watch::Receiver<BTreeSet<String>> {
        self.watched.subscribe()
    }

    /// The settings that it was made with.
    #[must_use]
    pub fn settings(&self) -> &GatewaySettings {
        &self.settings
    }

    /// Waits until a robot was heard.
    ///
    /// ```
    /// # use std::{collections::BTreeMap, sync::Arc};
    /// # use zenav_gateway::{GatewaySettings, Hub, Update};
    /// # #[tokio::main(flavor = "current_thread")]
    /// # async fn main() -> Result<(), tokio::task::JoinError> {
    /// let hub = Hub::new(GatewaySettings::default(), BTreeMap::new());
    /// let waiting = Arc::clone(&hub);
    /// let waiting = tokio::spawn(async move { waiting.first_robot().await });
    /// hub.take("tiago", Update::Part { component: "edge".into(), alive: true });
    /// hub.announce(true);
    /// waiting.await?;
    /// # Ok(())
    /// # }
    /// ```
    pub async fn first_robot(&self) {
        let mut rounds = self.rounds.subscribe();
        while self.view().robots().next().is_none() {
            if rounds.changed().await.is_err() {
                return;
            }
        }
    }

    /// Closes every browser's connection.
    pub fn end(&self) {
        self.ended.send_replace(true);
    }

    pub(crate) fn ended(&self) -> watch::Receiver<bool> {
        self.ended.subscribe()
    }

    pub(crate) fn is_connected(&self) -> bool {
        self.connected.load(Ordering::Relaxed)
    }

    pub(crate) fn places(&self) -> &BTreeMap<String, GoalPoint> {
        &self.places
    }

    /// Whether another request may be carried out now.
    pub(crate) fn admits(&self) -> bool {
        let mut rate = self.rate.lock().unwrap_or_else(PoisonError::into_inner);
        rate.take(self.start.elapsed())
    }

    /// Number of connected browsers.
    pub(crate) fn clients(&self) -> usize {
        self.clients.load(Ordering::Relaxed)
    }

    /// Counts another client until the guard is dropped; `None` when there are too many.
    pub(crate) fn join(self: &Arc<Self>) -> Option<Joined> {
        let joined = self.clients.fetch_add(1, Ordering::Relaxed);
        let guard = Joined {
            hub: Arc::clone(self),
            watching: None,
        };
        (joined < self.settings.max_clients).then_some(guard)
    }

    fn count(&self, robot: &str, comes: bool) {
        let mut watchers = self.watchers.lock().unwrap_or_else(PoisonError::into_inner);
        let count = watchers.entry(robot.to_owned()).or_default();
        *count = if comes { *count + 1 } else { count.saturating_sub(1) };
        if *count == 0 {
            watchers.remove(robot);
        }
        let now: BTreeSet<String> = watchers.keys().cloned().collect();
        self.watched.send_if_modified(|watched| {
            let differs = *watched != now;
            *watched = now;
            differs
        });
    }
}

/// A connected client; dropped when it leaves.
#[derive(Debug)]
pub(crate) struct Joined {
    hub: Arc<Hub>,
    watching: Option<String>,
}

impl Joined {
    /// Switches the client to watching this robot.
    pub(crate) fn watch(&mut self, robot: Option<&str>) {
        if let Some(robot) = robot {
            self.hub.count(robot, true);
        }
        if let Some(before) = self.watching.take() {
            self.hub.count(&before, false);
        }
        self.watching = robot.map(str::to_owned);
    }
}

impl Drop for Joined {
    fn drop(&mut self) {
        if let Some(robot) = self.watching.take() {
            self.hub.count(&robot, false);
        }
        self.hub.clients.fetch_sub(1, Ordering::Relaxed);
    }
}
