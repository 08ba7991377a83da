//! Declaration. One row of [`metrics`](crate::metrics) defines a metric: its static, its registry entry and its line in the docs.

use std::sync::LazyLock;

use prometheus::core::Collector;
use prometheus::{CounterVec, GaugeVec, HistogramOpts, HistogramVec, IntCounterVec, IntGaugeVec, Opts, Registry};

/// Buckets of every latency, s: from the collision monitor's microseconds to a path search that uses its whole budget.
pub(crate) const LATENCIES: &[f64] = &[
    1e-5, 2.5e-5, 5e-5, 1e-4, 2.5e-4, 5e-4, 1e-3, 2.5e-3, 5e-3, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0,
];

/// The registry of this process.
pub(crate) static REGISTRY: LazyLock<Registry> = LazyLock::new(Registry::new);

/// Kind of a metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Only grows.
    Counter,
    /// Goes up and down.
    Gauge,
    /// Counts durations in buckets.
    Histogram,
}

impl Kind {
    /// Name in Prometheus' text format.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Counter => "counter",
            Self::Gauge => "gauge",
            Self::Histogram => "histogram",
        }
    }
}

/// One metric.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Name, with its unit.
    pub name: &'static str,
    /// Counter, gauge or histogram.
    pub kind: Kind,
    /// Labels of its series.
    pub labels: &'static [&'static str],
    /// Help text.
    pub help: &'static str,
    /// Stage of the data flow, or part, that it belongs to.
    pub stage: &'static str,
}

/// A kind of metric with labels.
pub(crate) trait Declared: Collector + Clone + Sized + 'static {
    const KIND: Kind;
    fn new(opts: Opts, labels: &[&str]) -> prometheus::Result<Self>;
}

macro_rules! declared {
    ($($Type:ident: $kind:ident),*) => {$(
        impl Declared for $Type {
            const KIND: Kind = Kind::$kind;
            fn new(opts: Opts, labels: &[&str]) -> prometheus::Result<Self> {
                Self::new(opts, labels)
            }
        }
    )*};
}
declared!(IntCounterVec: Counter, CounterVec: Counter, GaugeVec: Gauge, IntGaugeVec: Gauge);

impl Declared for HistogramVec {
    const KIND: Kind = Kind::Histogram;
    fn new(opts: Opts, labels: &[&str]) -> prometheus::Result<Self> {
        let opts = HistogramOpts::from(opts).buckets(LATENCIES.to_vec());
        Self::new(opts, labels)
    }
}

/// Creates a declared metric and registers it.
pub(crate) fn declared<T: Declared>(name: &str, help: &str, labels: &[&str]) -> T {
    let made = T::new(Opts::new(name, help.trim()), labels)
        .and_then(|metric| REGISTRY.register(Box::new(metric.clone())).map(|()| metric));
    match made {
        Ok(metric) => metric,
        // The declarations are constants, and a test creates each one.
        Err(error) => unreachable!("{name}: {error}"),
    }
}

/// Declares metrics: `STATIC: Type = "name" [labels], "help";`, in the groups of their stages.
macro_rules! metrics {
    ($($stage:literal { $($NAME:ident: $Type:ident = $name:literal [$($label:literal),*], $help:literal;)* })*) => {
        $($(
            #[doc = concat!("`", $name, "`: ", $help)]
            pub static $NAME: std::sync::LazyLock<$Type> =
                std::sync::LazyLock::new(|| $crate::declare::declared($name, $help, &[$($label),*]));
        )*)*

        /// Creates every metric.
        #[cfg(test)]
        fn make_all() {
            $($(std::sync::LazyLock::force(&$NAME);)*)*
        }

        /// Every metric, in the order of the data flow.
        pub const TABLE: &[$crate::Row] = &[$($(
            $crate::Row {
                name: $name,
                kind: <$Type as $crate::declare::Declared>::KIND,
                labels: &[$($label),*],
                help: $help,
                stage: $stage,
            },
        )*)*];
    };
}
pub(crate) use metrics;
