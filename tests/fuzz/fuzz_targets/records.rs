//! Bytes from anywhere as a record of a run, or its samples.
#![no_main]

zenav_fuzz::target!(records);
