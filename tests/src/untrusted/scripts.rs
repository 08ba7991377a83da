//! Scripts of `zenav netem`.

use zenav::netem::Script;

/// Every kind of change.
const SCRIPT: &str = "\
# a link
0s delay 80ms
5s jitter 20ms
10s rate 256kbit
15s rate none
20s stall 500ms/10s # now and then
25s stall none
30s cut 5s
45s reset
1min delay 0ms
";

/// A script.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    vec![SCRIPT.as_bytes().to_vec()]
}

/// Reads the text as a script.
pub fn exercise(bytes: &[u8]) -> usize {
    let text = String::from_utf8_lossy(bytes);
    usize::from(Script::default().read(&text).is_ok())
}
