//! Does the workspace follow `ARCHITECTURE.md`?
//!
//! | file | checks |
//! |---|---|
//! | `packages` | which package may depend on which, directly and transitively; licences; metadata of published crates |
//! | `purity` | where clocks, files, threads, the network and randomness are used |
//! | `pages` | the key table, the links of every page, and the files that `ARCHITECTURE.md` names |
//! | `workspace` | Cargo's metadata of the workspace |
//! | `sources` | the files of a crate without its tests, and the paths that they name |

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod packages;
mod pages;
mod purity;
mod sources;
mod workspace;
