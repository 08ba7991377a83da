//! Rows. The faults of the table, each with its world, its policy for a lost link, and the number of injections.

use zenav_protocol::messages::LostPolicy;

/// A part of a deployment, in its own process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PartKind {
    /// The router.
    Router,
    /// The robot.
    Edge,
    /// The mapper.
    Mapping,
    /// The motion worker.
    Motion,
    /// The orchestrator.
    Mission,
    /// A second mapper, in rows that have one.
    Copy,
}

/// The parts of every row, in the usual starting order.
pub const PARTS: [PartKind; 5] = [
    PartKind::Router,
    PartKind::Edge,
    PartKind::Mapping,
    PartKind::Motion,
    PartKind::Mission,
];

impl PartKind {
    /// Its name in the table.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Router => "router",
            Self::Edge => "edge",
            Self::Mapping => "mapping",
            Self::Motion => "motion",
            Self::Mission => "mission",
            Self::Copy => "copy of mapping",
        }
    }
}

/// Where the robot drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The shipped kitchen.
    Kitchen,
    /// A hall of 20 m with three rows of shelves.
    Depot,
}

/// Permanent condition of the robot's link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// Plain loopback.
    Good,
    /// Round trip, ms.
    RoundTrip(u32),
    /// Lost segments each way, percent.
    Loss(u32),
    /// Rate each way, kbit/s.
    Rate(u32),
    /// Rate each way, kbit/s, and round trip, ms.
    RateAndRoundTrip(u32, u32),
}

/// The fault that is injected repeatedly; durations in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Nothing.
    None,
    /// The robot's link is cut.
    Cut(u32),
    /// A part is killed, and restarted at once.
    Kill(PartKind),
    /// A part is ended as by a service manager (`SIGTERM`), and restarted.
    Restart(PartKind),
    /// A part is frozen.
    Freeze(PartKind, u32),
    /// A part's disk is full.
    Full(PartKind, u32),
    /// A part's wall clock is so many hours ahead.
    Clock(PartKind, u32, i32),
    /// Recent messages are republished on every key at ten times their rate.
    Flood(u32),
    /// A second robot of the same name is on the bus.
    Twin(u32),
}

/// The row of a world without a fault.
const NO_FAULT: &str = "no fault";

/// One row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name in the table and on the command line.
    pub name: String,
    /// Where the robot drives.
    pub place: Place,
    /// The robot's policy for a lost link.
    pub policy: LostPolicy,
    /// Its link.
    pub line: Line,
    /// The fault.
    pub fault: Fault,
    /// Number of injections.
    pub times: usize,
    /// Least number of missions.
    pub missions: usize,
    /// Starting orders of the parts: the row runs once in each.
    pub orders: Vec<[PartKind; 5]>,
    /// Whether a second mapper follows the first one. A fault of the mapper then hits the one that leads.
    pub has_copy: bool,
    /// Whether the parts have identities: their links are encrypted, over QUIC.
    pub has_identities: bool,
}

impl Row {
    fn new(place: Place, what: &str) -> Self {
        let world = match place {
            Place::Kitchen => "kitchen",
            Place::Depot => "depot",
        };
        Self {
            name: format!("{world}: {what}"),
            place,
            policy: LostPolicy::FinishHorizon,
            line: Line::Good,
            fault: Fault::None,
            times: 0,
            missions: 2,
            orders: vec![PARTS],
            has_copy: false,
            has_identities: false,
        }
    }

    fn line(place: Place, what: &str, line: Line) -> Self {
        Self {
            line,
            ..Self::new(place, what)
        }
    }

    /// One mission for each order in which the parts are started.
    fn started(place: Place, what: &str, orders: Vec<[PartKind; 5]>) -> Self {
        Self {
            orders,
            missions: 1,
            ..Self::new(place, what)
        }
    }

    fn fault(place: Place, what: &str, fault: Fault, times: usize) -> Self {
        Self {
            fault,
            times,
            ..Self::new(place, what)
        }
    }

    /// Most time of a mission, as a multiple of that without a fault, if it is limited.
    #[must_use]
    pub const fn most_slowdown(&self) -> Option<f64> {
        match self.line {
            Line::RoundTrip(1000) => Some(1.2),
            Line::RoundTrip(2000) => Some(2.0),
            _ => None,
        }
    }

    /// Name of the row whose missions those of this one are compared with, if their time is limited.
    #[must_use]
    pub fn compared_with(&self) -> Option<String> {
        let base = Self::new(self.place, NO_FAULT);
        let base = if self.has_identities { base.identified() } else { base };
        self.most_slowdown().map(|_| base.name)
    }

    fn copied(self) -> Self {
        Self {
            name: format!("{}, with a copy", self.name),
            has_copy: true,
            ..self
        }
    }

    fn identified(self) -> Self {
        Self {
            name: format!("{}, mTLS", self.name),
            has_identities: true,
            ..self
        }
    }

    fn braking(self) -> Self {
        Self {
            name: format!("{}, policy `stop`", self.name),
            policy: LostPolicy::Stop,
            ..self
        }
    }
}

/// The rows of the whole table.
#[must_use]
pub fn all() -> Vec<Row> {
    let mut rows = Vec::new();
    for place in [Place::Depot, Place::Kitchen] {
        rows.push(Row::new(place, NO_FAULT));
        for millis in [50, 200, 500, 1000, 2000, 5000] {
            let what = format!("round trip {millis} ms");
            rows.push(Row::line(place, &what, Line::RoundTrip(millis)));
        }
        for percent in [5, 20] {
            rows.push(Row::line(place, &format!("loss {percent} %"), Line::Loss(percent)));
        }
        rows.push(Row::line(place, "256 kbit/s", Line::Rate(256)));
        let what = "256 kbit/s and round trip 600 ms";
        rows.push(Row::line(place, what, Line::RateAndRoundTrip(256, 600)));
        for (secs, times) in [(1, 3), (5, 3), (15, 2), (60, 1)] {
            rows.push(Row::fault(place, &format!("cuts of {secs} s"), Fault::Cut(secs), times));
        }
        for part in PARTS {
            let what = if part == PartKind::Router {
                "router replaced".to_owned()
            } else {
                format!("{} killed", part.name())
            };
            rows.push(Row::fault(place, &what, Fault::Kill(part), 3));
        }
        for part in PARTS {
            let what = format!("{} restarted", part.name());
            rows.push(Row::fault(place, &what, Fault::Restart(part), 2));
        }
        for part in PARTS {
            let what = format!("{} frozen for 5 s", part.name());
            rows.push(Row::fault(place, &what, Fault::Freeze(part, 5), 2));
        }
        for (what, fault, times) in [
            ("mapping killed", Fault::Kill(PartKind::Mapping), 3),
            ("mapping frozen for 5 s", Fault::Freeze(PartKind::Mapping, 5), 2),
        ] {
            rows.push(Row::fault(place, what, fault, times).copied());
        }
        for part in [PartKind::Edge, PartKind::Mapping, PartKind::Mission] {
            let what = format!("disk of {} full for 5 s", part.name());
            rows.push(Row::fault(place, &what, Fault::Full(part, 5), 2));
        }
        for (how, hours) in [("ahead", 1), ("behind", -1)] {
            for part in PARTS {
                let what = format!("wall clock of {} an hour {how} for 5 s", part.name());
                rows.push(Row::fault(place, &what, Fault::Clock(part, 5, hours), 2));
            }
        }
        rows.push(Row::fault(place, "flood for 5 s", Fault::Flood(5), 3));
        rows.push(Row::fault(place, "second robot of the name for 5 s", Fault::Twin(5), 2));
        for (what, order) in orders() {
            rows.push(Row::started(place, what, vec![order]));
        }
    }
    rows.push(Row::started(
        Place::Kitchen,
        "started in each of 120 orders",
        every_order(),
    ));
    let is_order = |row: &Row| row.orders.len() == 1 && row.orders != [PARTS];
    let has_fault = |row: &&Row| row.line != Line::Good || row.fault != Fault::None || is_order(row);
    let braking: Vec<Row> = rows.iter().filter(has_fault).cloned().map(Row::braking).collect();
    // What differs between the two kinds of links is how they bear delay, loss, narrowness and cuts.
    let is_of_link = |row: &&Row| row.orders == [PARTS] && matches!(row.fault, Fault::None | Fault::Cut(_));
    let identified: Vec<Row> = rows.iter().filter(is_of_link).cloned().map(Row::identified).collect();
    rows.extend(braking);
    rows.extend(identified);
    rows
}

/// The row of this name, or without one all rows whose names contain it; and the rows that their missions are compared with.
///
/// # Errors
/// Without such a row; the message lists all names.
pub fn select(rows: &[Row], only: &str) -> Result<Vec<Row>, String> {
    let is_name = rows.iter().any(|row| row.name == only);
    let wanted: Vec<&Row> = rows
        .iter()
        .filter(|row| row.name == only || !is_name && row.name.contains(only))
        .collect();
    if wanted.is_empty() {
        let names: String = rows.iter().map(|row| format!("\n  {}", row.name)).collect();
        return Err(format!(
            "--only `{only}`: no such row; expected one of these names, or a part of one:{names}"
        ));
    }
    let compared: Vec<String> = wanted.iter().filter_map(|row| row.compared_with()).collect();
    let is_compared = |row: &Row| compared.contains(&row.name);
    Ok(rows
        .iter()
        .filter(|row| wanted.contains(row) || is_compared(row))
        .cloned()
        .collect())
}

/// A few representative rows that take a minute and a half.
#[must_use]
pub fn short() -> Vec<Row> {
    let one = |row: Row| Row { missions: 1, ..row };
    [
        Row::line(Place::Kitchen, "round trip 200 ms", Line::RoundTrip(200)),
        Row::fault(Place::Kitchen, "cut of 5 s", Fault::Cut(5), 1),
        Row::fault(Place::Kitchen, "mission killed", Fault::Kill(PartKind::Mission), 1),
    ]
    .map(one)
    .into()
}

fn orders() -> [(&'static str, [PartKind; 5]); 3] {
    use PartKind::{Edge, Mapping, Mission, Motion, Router};
    [
        ("started backwards", [Mission, Motion, Mapping, Edge, Router]),
        ("robot first, router last", [Edge, Mapping, Motion, Mission, Router]),
        ("motion worker last", [Router, Mission, Mapping, Edge, Motion]),
    ]
}

/// All orders of the parts.
fn every_order() -> Vec<[PartKind; 5]> {
    fn permute(order: &mut [PartKind; 5], from: usize, found: &mut Vec<[PartKind; 5]>) {
        if from == order.len() {
            found.push(*order);
        }
        for next in from..order.len() {
            order.swap(from, next);
            permute(order, from + 1, found);
            order.swap(from, next);
        }
    }
    let (mut order, mut found) = (PARTS, Vec::new());
    permute(&mut order, 0, &mut found);
    found
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn selected(only: &str) -> Vec<String> {
        let rows = select(&all(), only).unwrap_or_default();
        rows.into_iter().map(|row| row.name).collect()
    }

    #[test]
    fn a_name_selects_its_row_alone_and_a_part_of_one_all_that_contain_it() {
        assert_eq!(selected("depot: loss 5 %"), ["depot: loss 5 %"]);
        assert_eq!(selected("kitchen: flood for 5 s"), ["kitchen: flood for 5 s"]);
        assert_eq!(
            selected("loss 5 %").len(),
            6,
            "two worlds, two policies; and with identities"
        );
        assert_eq!(selected("").len(), all().len());
    }

    #[test]
    fn a_row_whose_slowdown_is_limited_brings_the_one_that_it_is_compared_with() {
        let name = "kitchen: round trip 1000 ms";
        assert_eq!(selected(name), ["kitchen: no fault", name]);
        let name = "kitchen: round trip 1000 ms, mTLS";
        assert_eq!(selected(name), ["kitchen: no fault, mTLS", name]);
    }

    #[test]
    fn each_condition_and_cut_of_a_link_is_also_there_with_identities() {
        for place in ["depot", "kitchen"] {
            // No fault, six round trips, two losses, two rates and four cuts.
            let with = selected("mTLS").into_iter().filter(|name| name.starts_with(place));
            assert_eq!(with.count(), 15);
        }
        assert!(all().iter().all(|row| row.has_identities == row.name.contains("mTLS")));
    }

    #[test]
    fn the_parts_start_in_each_order_once() {
        let orders: BTreeSet<[PartKind; 5]> = every_order().into_iter().collect();
        assert_eq!((orders.len(), every_order().len()), (120, 120));
        let is_whole = |order: &[PartKind; 5]| PARTS.iter().all(|part| order.contains(part));
        assert!(orders.iter().all(is_whole));
        assert_eq!(selected("each of 120 orders").len(), 1);
    }

    #[test]
    fn clocks_restarts_and_orders_of_start_are_in_both_worlds_with_both_policies() {
        for (what, parts) in [
            ("an hour ahead", 5),
            ("an hour behind", 5),
            ("restarted", 5),
            ("started backwards", 1),
        ] {
            assert_eq!(selected(what).len(), 4 * parts, "{what}");
        }
    }

    #[test]
    fn a_name_of_no_row_is_refused_with_all_names() {
        let refusal = select(&all(), "nonsense").unwrap_err();
        assert!(all().iter().all(|row| refusal.contains(&row.name)), "{refusal}");
    }

    #[test]
    fn a_mapper_with_a_copy_is_killed_and_frozen_in_both_worlds_with_both_policies() {
        for fault in ["mapping killed, with a copy", "mapping frozen for 5 s, with a copy"] {
            assert_eq!(selected(fault).len(), 4);
        }
        assert!(all().iter().all(|row| row.has_copy == row.name.contains("with a copy")));
    }

    #[test]
    fn every_row_has_a_name_of_its_own() {
        let mut names: Vec<String> = all().into_iter().map(|row| row.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), all().len());
    }
}
