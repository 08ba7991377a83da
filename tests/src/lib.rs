//! Rigs for tests, benches and acceptance runs across parts: processes of the binary under test on free ports, and simulated rigs.
//!
//! | module | holds |
//! |---|---|
//! | [`browser`] | a page in headless Chromium, used as by a person |
//! | [`process`] | real processes, started, paused and killed |
//! | [`deployment`] | a router, a robot and a cloud as separate processes |
//! | [`http`] | one HTTP request, by hand |
//! | [`secured`] | a fleet with identities, each part a separate process |
//! | [`hosts`] | multi-host deployments, as containers or in network namespaces |
//! | [`observer`] | what a robot publishes, and how to wait for it |
//! | [`acceptance`] | the long runs: many worlds, many kills |
//! | [`untrusted`] | any bytes as a message or a file, for the fuzz targets and an ordinary test |
//! | [`provenance`] | the machine and the commit of a run |
//! | [`usage`] | processor time and memory of a process |

pub mod acceptance;
pub mod browser;
pub mod deployment;
pub mod hosts;
pub mod http;
pub mod observer;
pub mod process;
pub mod provenance;
pub mod secured;
pub mod untrusted;
pub mod usage;
