//! Joining. Finds the pose of one map in an older one, with certainty, and joins both.
//!
//! A whole submap is searched for in the whole older map, at all headings ([`overview`]). A submap is more distinctive than a scan, and the
//! search also yields the second-best place of the whole map. Each search votes for the places it allows ([`vote`]). A map is found in the
//! other if enough searches agree on one place, no other place has nearly as many votes, and few scans contradict it with beams through the
//! other map's walls. Then single scans are matched to single submaps as in a loop closure, and both become one graph ([`join`]).
//!
//! | file | answers |
//! |---|---|
//! | `overview` | where in the whole of a map does something fit? |
//! | `vote` | which place do several searches agree on? |
//! | `join` | how do two graphs become one? |
//! | `resume` | where in the older map does the present session lie? |
//! | `merge` | are two maps of one building? |
//! | `repeated` | which sessions do two maps share? |
//! | `trim` | which submaps are no longer needed? |

mod join;
mod merge;
mod overview;
mod repeated;
mod resume;
mod trim;
mod vote;

pub use merge::{MergeError, merge, merge_timed};
pub(crate) use resume::{Older, locate};
