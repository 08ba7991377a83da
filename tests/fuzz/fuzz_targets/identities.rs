//! Bytes from anywhere as a certificate with a list of members.
#![no_main]

zenav_fuzz::target!(identities);
