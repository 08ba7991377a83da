//! Does the house stand as `ARCHITECTURE.md` says?
//!
//! | file | checks |
//! |---|---|
//! | `packages` | which package may depend on which, directly and through others; licences; what a published crate says of itself |
//! | `purity` | where time, files, threads, the network and chance come in |
//! | `pages` | the key table and the links of every page |
//! | `workspace` | the metadata that Cargo gives of the workspace |
//! | `sources` | the files that a crate is built of without its tests, and every path that they name |

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod packages;
mod pages;
mod purity;
mod sources;
mod workspace;
