//! Network. Messages may arrive late, out of order, twice, or never.
//!
//! Any message in transit may be the next to arrive, so all delays and orders are explored; a message that never arrives is lost. If a
//! message arrives twice, a copy stays in transit.

/// Messages in transit, unordered.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Network<M> {
    messages: Vec<M>,
}

impl<M> Default for Network<M> {
    fn default() -> Self {
        Self { messages: Vec::new() }
    }
}

impl<M: Clone + Ord> Network<M> {
    /// Sends a message.
    pub fn send(&mut self, message: M) {
        let place = self.messages.partition_point(|other| *other <= message);
        self.messages.insert(place, message);
    }

    /// Removes the message that arrives.
    pub fn arrives(&mut self, message: &M) {
        if let Ok(place) = self.messages.binary_search(message) {
            self.messages.remove(place);
        }
    }

    /// The distinct messages that may arrive next.
    pub fn under_way(&self) -> impl Iterator<Item = &M> {
        let differs = |place: usize| place == 0 || self.messages.get(place - 1) != self.messages.get(place);
        self.messages
            .iter()
            .enumerate()
            .filter(move |(place, _)| differs(*place))
            .map(|(_, message)| message)
    }

    /// Drops the messages that are not wanted.
    pub fn keep(&mut self, wanted: impl FnMut(&M) -> bool) {
        self.messages.retain(wanted);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_message_may_be_the_next_and_equal_ones_are_one_choice() {
        let mut network = Network::default();
        for message in [3, 1, 3] {
            network.send(message);
        }
        assert_eq!(network.under_way().copied().collect::<Vec<_>>(), [1, 3]);
        network.arrives(&3);
        assert_eq!(network.under_way().count(), 2);
        network.arrives(&3);
        network.arrives(&3);
        assert_eq!(network.under_way().copied().collect::<Vec<_>>(), [1]);
    }
}
