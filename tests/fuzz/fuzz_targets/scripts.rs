//! Bytes from anywhere as a script of `zenav netem`.
#![no_main]

zenav_fuzz::target!(scripts);
