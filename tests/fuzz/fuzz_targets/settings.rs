//! Bytes from anywhere as a file of a robot, an option, a world, or zones.
#![no_main]

zenav_fuzz::target!(settings);
