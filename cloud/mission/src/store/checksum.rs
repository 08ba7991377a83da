//! Checksum of a store. Are its records those that were written? It detects damage, not tampering.

/// Sum of the hashes of all records, independent of their order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Checksum(pub(super) u64);

impl Checksum {
    pub(super) fn add(&mut self, table: &str, key: &str, value: &[u8]) {
        self.0 = self.0.wrapping_add(hash(table, key, value));
    }

    pub(super) fn remove(&mut self, table: &str, key: &str, value: &[u8]) {
        self.0 = self.0.wrapping_sub(hash(table, key, value));
    }
}

/// FNV-1a, 64 bits, the same on every machine.
fn hash(table: &str, key: &str, value: &[u8]) -> u64 {
    let parts = [table.as_bytes(), &[0], key.as_bytes(), &[0], value];
    let bytes = parts.into_iter().flatten();
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    })
}
