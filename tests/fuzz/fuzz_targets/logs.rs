//! Bytes from anywhere as a CARMEN log, a pose graph, relations, or a SLAM session.
#![no_main]

zenav_fuzz::target!(logs);
