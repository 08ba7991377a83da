//! Bytes from anywhere as requests, plans and messages to a robot.
#![no_main]

zenav_fuzz::target!(pilot);
