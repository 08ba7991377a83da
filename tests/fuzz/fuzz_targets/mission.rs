//! Bytes from anywhere as requests, messages and answers to a mission.
#![no_main]

zenav_fuzz::target!(mission);
