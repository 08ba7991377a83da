//! Graph. When is SLAM's pose graph published? When it has changed, at most once a second and more rarely the larger it is, and if anybody
//! may hear it; unchanged, when a first subscriber comes and from time to time.

use zenav_protocol::time::Stamp;

use super::Leadership;

/// Shortest time between two graphs, s, and the number of nodes with which it grows by as much: the data rate stays bounded.
const PERIOD: f64 = 1.0;
const NODES: f64 = 500.0;
/// An unchanged graph is repeated after so many of these times, for a subscriber who came later.
const REPEATED: f64 = 10.0;

/// When the graph was last published.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct GraphPace {
    told: Option<Stamp>,
    /// Shortest time to the next one, s.
    period: f64,
    /// Whether there has been a subscriber ever since.
    is_known: bool,
}

impl GraphPace {
    /// Whether a graph may be published at `now`, and if so, whether an unchanged one, too. `is_heard`: there may be a subscriber.
    fn due(&mut self, now: Stamp, is_heard: bool) -> Option<bool> {
        self.is_known &= is_heard;
        // After a restart of the simulation its clock is before the last graph.
        let is_over = |periods: f64| {
            self.told
                .is_none_or(|then| now.secs_since(then) >= periods * self.period || now < then)
        };
        (is_heard && is_over(1.0)).then(|| !self.is_known || is_over(REPEATED))
    }

    fn told(&mut self, now: Stamp, nodes: usize) {
        (self.told, self.is_known) = (Some(now), true);
        self.period = PERIOD * (1.0 + nodes as f64 / NODES);
    }
}

impl Leadership {
    /// Publishes SLAM's pose graph if it is due.
    pub(super) fn tell_graph(&mut self, now: Stamp) {
        let Some(anyway) = self.graph_pace.due(now, self.outbox.graphs.may_be_heard()) else {
            return;
        };
        if let Some(graph) = self.core.untold_graph(anyway) {
            self.outbox.graphs.put(&graph);
            self.graph_pace.told(now, graph.nodes.len());
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
        pace.told(at(10.2), 0);
        assert_eq!(pace.due(at(11.1), true), None);
        assert_eq!(pace.due(at(11.2), true), Some(false));
        pace.told(at(11.2), 0);
        assert_eq!(pace.due(at(11.3), false), None);
        assert_eq!(
            pace.due(at(11.4), true),
            None,
            "no sooner for a subscriber who comes again"
        );
        assert_eq!(pace.due(at(12.2), true), Some(true));
        assert_eq!(pace.due(at(1.0), true), Some(true), "another simulation");
        pace.told(at(20.0), 1500);
        assert_eq!(pace.due(at(23.9), true), None, "a large one goes out more rarely");
        assert_eq!(pace.due(at(24.0), true), Some(false));
        assert_eq!(pace.due(at(60.0), true), Some(true), "for a subscriber who came later");
    }
}
