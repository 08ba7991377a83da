//! Inbox. How are the readers decoupled from Zenoh's receiving threads, which must never block?
//!
//! A bounded store with one reader: [`Queue`] keeps the newest items in order, [`Newest`] the newest item of each key. Both count the items
//! they drop.

use std::collections::{HashMap, VecDeque};
use std::hash::Hash;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;
use zenav_observability::IntGauge;

/// Most keys in a [`Newest`]; items of further keys are dropped.
const MAX_KEYS: usize = 4096;

/// The store behind an inbox.
pub(super) trait Store {
    type Item;
    /// Adds an item; `false` if an item was dropped.
    fn put(&mut self, item: Self::Item) -> bool;
    fn pop(&mut self) -> Option<Self::Item>;
    fn len(&self) -> usize;
}

/// All items in order; the oldest is dropped when full.
pub(super) struct Queue<T> {
    items: VecDeque<T>,
    capacity: usize,
}

impl<T> Queue<T> {
    pub(super) fn new(capacity: usize) -> Self {
        Self {
            items: VecDeque::new(),
            capacity: capacity.max(1),
        }
    }
}

impl<T> Store for Queue<T> {
    type Item = T;

    fn put(&mut self, item: T) -> bool {
        let full = self.items.len() >= self.capacity;
        if full {
            self.items.pop_front();
        }
        self.items.push_back(item);
        !full
    }

    fn pop(&mut self) -> Option<T> {
        self.items.pop_front()
    }

    fn len(&self) -> usize {
        self.items.len()
    }
}

/// The newest item of each key; the keys take turns.
pub(super) struct Newest<K, T> {
    turns: VecDeque<K>,
    items: HashMap<K, T>,
}

impl<K, T> Newest<K, T> {
    pub(super) fn new() -> Self {
        Self {
            turns: VecDeque::new(),
            items: HashMap::new(),
        }
    }
}

impl<K: Hash + Eq + Clone, T> Store for Newest<K, T> {
    type Item = (K, T);

    fn put(&mut self, (key, item): (K, T)) -> bool {
        if let Some(place) = self.items.get_mut(&key) {
            // Replacing an unread item is the purpose of this store: not counted as a loss.
            *place = item;
            return true;
        }
        if self.items.len() >= MAX_KEYS {
            return false;
        }
        self.turns.push_back(key.clone());
        self.items.insert(key, item);
        true
    }

    fn pop(&mut self) -> Option<(K, T)> {
        let key = self.turns.pop_front()?;
        self.items.remove(&key).map(|item| (key, item))
    }

    fn len(&self) -> usize {
        self.items.len()
    }
}

/// A bounded inbox with one reader.
pub(super) struct Inbox<S: Store> {
    state: Mutex<State<S>>,
    ready: Notify,
    dropped: AtomicU64,
    /// Number of waiting items, here and in other inboxes that share the gauge.
    waiting: Option<IntGauge>,
}

struct State<S> {
    store: S,
    closed: bool,
}

impl<S: Store> Inbox<S> {
    /// An inbox, and the slot that fills it; dropping the slot closes the inbox.
    pub(super) fn new(store: S) -> (Arc<Self>, Slot<S>) {
        Self::with(store, None)
    }

    /// As [`Self::new`]; the number of waiting items is added to a gauge.
    pub(super) fn gauged(store: S, waiting: IntGauge) -> (Arc<Self>, Slot<S>) {
        Self::with(store, Some(waiting))
    }

    fn with(store: S, waiting: Option<IntGauge>) -> (Arc<Self>, Slot<S>) {
        let inbox = Arc::new(Self {
            state: Mutex::new(State { store, closed: false }),
            ready: Notify::new(),
            dropped: AtomicU64::new(0),
            waiting,
        });
        (Arc::clone(&inbox), Slot(inbox))
    }

    /// Updates the gauge after a change of the store's length.
    fn gauge(&self, before: usize, after: usize) {
        if let Some(waiting) = &self.waiting
            && before != after
        {
            waiting.add(after as i64 - before as i64);
        }
    }

    fn pop(&self, state: &mut State<S>) -> Option<S::Item> {
        let before = state.store.len();
        let item = state.store.pop();
        self.gauge(before, state.store.len());
        item
    }

    fn lock(&self) -> MutexGuard<'_, State<S>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next item, if there is one; never waits.
    pub(super) fn try_next(&self) -> Option<S::Item> {
        self.pop(&mut self.lock())
    }

    /// Waits for the next item; `None` once the inbox is empty and closed.
    pub(super) async fn next(&self) -> Option<S::Item> {
        loop {
            {
                let mut state = self.lock();
                if let Some(item) = self.pop(&mut state) {
                    return Some(item);
                }
                if state.closed {
                    return None;
                }
            }
            // `Notify` stores a permit given since the check above: no wake-up is lost.
            self.ready.notified().await;
        }
    }

    /// Waits until there is an item; `false` once the inbox is empty and closed.
    pub(super) async fn filled(&self) -> bool {
        loop {
            {
                let state = self.lock();
                if state.store.len() > 0 {
                    return true;
                }
                if state.closed {
                    return false;
                }
            }
            self.ready.notified().await;
        }
    }

    /// Number of items dropped so far because the reader was too slow.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

impl<S: Store> Drop for Inbox<S> {
    fn drop(&mut self) {
        self.gauge(self.lock().store.len(), 0);
    }
}

/// The writing end of an inbox.
pub(super) struct Slot<S: Store>(Arc<Inbox<S>>);

impl<S: Store> Slot<S> {
    /// Adds an item; blocks only for the reader's short critical section.
    pub(super) fn put(&self, item: S::Item) {
        self.fits(item);
    }

    /// As [`Self::put`]; `false` if an item was dropped.
    pub(super) fn fits(&self, item: S::Item) -> bool {
        let fits = {
            let mut state = self.0.lock();
            let before = state.store.len();
            let fits = state.store.put(item);
            self.0.gauge(before, state.store.len());
            fits
        };
        if !fits {
            self.0.dropped.fetch_add(1, Ordering::Relaxed);
        }
        self.0.ready.notify_one();
        fits
    }

    /// Adds an item unless `capacity` items are waiting; returns it otherwise.
    pub(super) fn put_within(&self, item: S::Item, capacity: usize) -> Option<S::Item> {
        {
            let mut state = self.0.lock();
            if state.store.len() >= capacity {
                return Some(item);
            }
            let before = state.store.len();
            state.store.put(item);
            self.0.gauge(before, state.store.len());
        }
        self.0.ready.notify_one();
        None
    }
}

impl<S: Store> Drop for Slot<S> {
    fn drop(&mut self) {
        self.0.lock().closed = true;
        self.0.ready.notify_one();
    }
}

/// Counts failures, and selects those to log: the 1st, 2nd, 4th, 8th, …
#[derive(Default)]
pub(super) struct Complaints(AtomicU64);

impl Complaints {
    /// Counts a failure; returns the count if it is to be logged.
    pub(super) fn add(&self) -> Option<u64> {
        let count = self.0.fetch_add(1, Ordering::Relaxed) + 1;
        count.is_power_of_two().then_some(count)
    }

    pub(super) fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_full_queue_drops_the_oldest_and_counts() {
        let (inbox, slot) = Inbox::new(Queue::new(3));
        for item in 0..5 {
            slot.put(item);
        }
        assert_eq!(inbox.dropped(), 2);
        drop(slot);
        let mut seen = Vec::new();
        while let Some(item) = inbox.next().await {
            seen.push(item);
        }
        assert_eq!(seen, [2, 3, 4]);
    }

    #[tokio::test]
    async fn the_newest_of_each_key_is_kept_and_keys_take_turns() {
        let (inbox, slot) = Inbox::new(Newest::new());
        for item in [("a", 1), ("b", 1), ("a", 2)] {
            slot.put(item);
        }
        assert_eq!(inbox.try_next(), Some(("a", 2)));
        slot.put(("a", 3));
        assert_eq!(inbox.try_next(), Some(("b", 1)), "a busy key does not starve another");
        assert_eq!(inbox.try_next(), Some(("a", 3)));
        assert_eq!(inbox.try_next(), None);
        assert_eq!(inbox.dropped(), 0);
    }

    #[test]
    fn keys_from_outside_do_not_fill_the_memory() {
        let (inbox, slot) = Inbox::new(Newest::new());
        for key in 0..MAX_KEYS + 10 {
            slot.put((key, ()));
        }
        assert_eq!(inbox.lock().store.len(), MAX_KEYS);
        assert_eq!(inbox.dropped(), 10);
    }

    #[tokio::test]
    async fn a_waiting_reader_is_woken_by_an_item_and_by_the_end() {
        let (inbox, slot) = Inbox::new(Queue::new(1));
        let reader = tokio::spawn({
            let inbox = Arc::clone(&inbox);
            async move { (inbox.next().await, inbox.next().await) }
        });
        tokio::task::yield_now().await;
        slot.put(7);
        tokio::task::yield_now().await;
        drop(slot);
        assert_eq!(reader.await.unwrap(), (Some(7), None));
    }

    #[test]
    fn complaints_are_rare() {
        let complaints = Complaints::default();
        assert_eq!(
            (0..1000).filter_map(|_| complaints.add()).collect::<Vec<_>>(),
            [1, 2, 4, 8, 16, 32, 64, 128, 256, 512]
        );
    }
}
