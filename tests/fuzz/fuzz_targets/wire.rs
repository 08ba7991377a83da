//! Bytes from anywhere as the message of every row of the key table, as JSON and as CBOR.
#![no_main]

zenav_fuzz::target!(wire);
