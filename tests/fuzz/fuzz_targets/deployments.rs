//! Bytes from anywhere as a deployment file.
#![no_main]

zenav_fuzz::target!(deployments);
