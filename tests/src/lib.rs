//! The rig that tests and benches across parts stand on: processes of the binary under test, on free ports.

pub mod process;
