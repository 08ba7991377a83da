//! Graph. When is SLAM's pose graph published? When it has changed, at most once a second, and if anybody may hear it; the present one
//! when a first subscriber comes.

use zenav_protocol::time::Stamp;

use super::Service;

/// Shortest time between two graphs, s.
const PERIOD: f64 = 1.0;

/// When the graph was last published.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct GraphPace {
    told: Option<Stamp>,
    /// Whether there has been a subscriber ever since.
    is_known: bool,
}

impl GraphPace {
    /// Whether a graph may be published at `now`, and if so, whether an unchanged one, too. `is_heard`: there may be a subscriber.
    fn due(&mut self, now: Stamp, is_heard: bool) -> Option<bool> {
        self.is_known &= is_heard;
        // After a restart of the simulation its clock is before the last graph.
        let is_over = |then: Stamp| now.secs_since(then) >= PERIOD || now < then;
        (is_heard && self.told.is_none_or(is_over)).then_some(!self.is_known)
    }

    fn told(&mut self, now: Stamp) {
        (self.told, self.is_known) = (Some(now), true);
    }
}

impl Service {
    /// Publishes SLAM's pose graph if it is due.
    pub(super) fn tell_graph(&mut self, now: Stamp) {
        let Some(anyway) = self.graph_pace.due(now, self.graphs.may_be_heard()) else {
            return;
        };
        if let Some(graph) = self.core.untold_graph(anyway) {
            self.graphs.put(&graph);
            self.graph_pace.told(now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_graph_goes_out_once_a_second_and_to_a_first_subscriber_if_it_has_not_changed_too() {
        let mut pace = GraphPace::default();
        let at = Stamp::from_secs;
        assert_eq!(pace.due(at(10.0), false), None, "nobody listens");
        assert_eq!(pace.due(at(10.1), true), Some(true));
        assert_eq!(pace.due(at(10.2), true), Some(true), "none was published yet");
        pace.told(at(10.2));
        assert_eq!(pace.due(at(11.1), true), None);
        assert_eq!(pace.due(at(11.2), true), Some(false));
        pace.told(at(11.2));
        assert_eq!(pace.due(at(11.3), false), None);
        assert_eq!(
            pace.due(at(11.4), true),
            None,
            "no sooner for a subscriber who comes again"
        );
        assert_eq!(pace.due(at(12.2), true), Some(true));
        assert_eq!(pace.due(at(1.0), true), Some(true), "another simulation");
    }
}
