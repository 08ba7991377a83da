//! Repeated. Which sessions do two maps share?
//!
//! A scan is some hundred points with the noise of its sensor: no robot measures the same one twice. Equal scans are one measurement that
//! was saved twice.

use std::collections::BTreeMap;

use crate::session::packed;
use crate::slam::Slam;

/// Equal scans by which a session is recognised, or all of a shorter one: in a simulation without noise a robot at rest may measure one scan
/// twice.
const EQUAL: usize = 3;

/// The first sessions of `a` and of `b`, by number from 0, that hold the same scans. A session may have been trimmed, or continued, after it
/// was saved in the other map.
pub(super) fn repeated(a: &Slam, b: &Slam) -> Option<(usize, usize)> {
    let known: BTreeMap<Vec<i32>, usize> = scans(a).collect();
    let mut equal: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (scan, session) in scans(b) {
        if let Some(same) = known.get(&scan) {
            *equal.entry((*same, session)).or_default() += 1;
        }
    }
    let is_repeated = |((first, second), count): &((usize, usize), usize)| {
        let nodes = a.sessions[*first].nodes.min(b.sessions[*second].nodes);
        *count >= EQUAL.min(nodes)
    };
    equal.into_iter().find(is_repeated).map(|(sessions, _)| sessions)
}

/// Each scan that shows anything, as offsets from point to point, mm, with the number of its session.
fn scans(slam: &Slam) -> impl Iterator<Item = (Vec<i32>, usize)> {
    let numbered = slam.sessions.iter().enumerate();
    let sessions = numbered.flat_map(|(number, session)| std::iter::repeat_n(number, session.nodes));
    let scans = slam.scans.iter().zip(sessions);
    scans
        .filter(|(scan, _)| !scan.is_empty())
        .map(|(scan, session)| (packed(scan), session))
}
