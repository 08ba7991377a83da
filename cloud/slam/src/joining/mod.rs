//! Joining. Where in an older map is this one, and is that certain?
//!
//! A whole submap is searched for in the whole older map, at all headings ([`overview`]): it is more telling than a scan, and the second best
//! place of the whole map is known with it. Each such search votes for the places that it allows ([`vote`]). One map is found in the other
//! where enough searches agree on one place, no other place has nearly as many votes, and few scans contradict it, their beams through the
//! other map's walls. Then single scans are matched to single submaps as in a loop closure, and both are one graph ([`join`]).
//!
//! | file | answers |
//! |---|---|
//! | `overview` | where in the whole of a map does something fit? |
//! | `vote` | which place do several searches agree on? |
//! | `join` | how do two graphs become one? |
//! | `resume` | where in the older map does the session that goes on lie? |
//! | `merge` | are two maps of one building? |
//! | `trim` | which submaps are no longer needed? |

mod join;
mod merge;
mod overview;
mod resume;
mod trim;
mod vote;

pub use merge::{MergeError, merge};
pub(crate) use resume::{Older, locate};
