//! Key patterns. How is a key made of a pattern with named chunks, and taken apart again?

/// The key with the pattern's named chunks filled in order; a missing one becomes `*`.
pub(super) fn fill(pattern: &str, chunks: &[&str]) -> String {
    let mut rest = chunks.iter();
    let filled: Vec<&str> = pattern
        .split('/')
        .map(|chunk| {
            if chunk.starts_with('{') {
                rest.next().copied().unwrap_or("*")
            } else {
                chunk
            }
        })
        .collect();
    filled.join("/")
}

/// The chunks of a concrete key at the pattern's names; `None` for a key of another pattern.
pub(super) fn unfill<'k>(pattern: &str, key: &'k str) -> Option<Vec<&'k str>> {
    let mut found = Vec::new();
    let mut parts = key.split('/');
    for chunk in pattern.split('/') {
        let part = parts.next()?;
        if chunk.starts_with('{') {
            found.push(part);
        } else if chunk != part {
            return None;
        }
    }
    parts.next().is_none().then_some(found)
}

/// The same; empty for a key of another pattern.
pub(super) fn owned_chunks(pattern: &str, key: &str) -> Vec<String> {
    let found = unfill(pattern, key).unwrap_or_default();
    found.into_iter().map(str::to_owned).collect()
}

/// Liveliness of a robot's component (`edge`, `mapping`, `mission`; `mapping-standby` for copies of the mapping service): for discovery
/// only, never for authority.
pub const ALIVE_COMPONENT: &str = "zenav/{robot}/alive/{component}";
/// Liveliness of a stateless `motion` worker, and of a group's goal server (`group-{name}`).
pub const ALIVE_WORKER: &str = "zenav/svc/alive/{service}/{worker}";

/// Fills the named chunks of a liveliness pattern in order.
#[must_use]
pub fn alive_key(pattern: &str, chunks: &[&str]) -> String {
    fill(pattern, chunks)
}

/// The named chunks of a concrete liveliness key.
#[must_use]
pub fn alive_chunks<'k>(pattern: &str, key: &'k str) -> Option<Vec<&'k str>> {
    unfill(pattern, key)
}
