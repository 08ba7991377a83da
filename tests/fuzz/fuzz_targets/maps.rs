//! Bytes from anywhere as a map image, a description with its image, or a Moving AI map.
#![no_main]

zenav_fuzz::target!(maps);
