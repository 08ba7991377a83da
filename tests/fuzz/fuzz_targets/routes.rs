//! Bytes from anywhere as what arrives on a connection of the page's server and of a health endpoint.
#![no_main]

zenav_fuzz::target!(routes);
