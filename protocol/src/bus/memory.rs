//! Memory. Why does a process with sessions not grow while its links come and go?
//!
//! Over QUIC, each attempt to dial has a receive buffer of 2.9 MiB (quinn 0.11: 32 messages of 64 segments of 1472 bytes), which lasts as long
//! as the link. glibc's allocator maps the first one separately and returns it to the system. It takes that as a sign that such blocks are
//! short-lived: later ones come from its arenas, of which the process has eight per core, and each arena keeps what was freed in it. So a process
//! that dials again and again grows by tens of MiB, without a leak.
//!
//! With a fixed limit every such buffer is mapped separately, and returned. Fewer arenas keep less of everything smaller. glibc reads both
//! from the environment when a process starts; [`threads`](super::threads) sets them.

/// Blocks of this size and above are mapped separately, bytes: less than a receive buffer, and more than most of what a search allocates.
const MAPPED: &str = "1048576";
/// Most arenas. Each keeps about a MiB, and threads with the same one wait for each other while they allocate blocks above 1 KiB.
const ARENAS: &str = "4";

/// Variables of glibc's allocator, with their values; none with another allocator.
pub(super) const SETTINGS: &[(&str, &str)] = if cfg!(all(target_os = "linux", target_env = "gnu")) {
    &[("MALLOC_MMAP_THRESHOLD_", MAPPED), ("MALLOC_ARENA_MAX", ARENAS)]
} else {
    &[]
};

#[cfg(test)]
#[cfg(all(target_os = "linux", target_env = "gnu"))]
mod tests {
    use std::process::Command;
    use std::sync::Barrier;

    use super::*;

    /// Set in the process that dials.
    const DIALS: &str = "ZENAV_TEST_DIALS";
    const THIS: &str = "bus::memory::tests::a_process_that_dials_again_and_again_returns_its_buffers";
    /// A receive buffer, bytes.
    const BUFFER: usize = 32 * 64 * 1472;
    /// Threads that dial.
    const THREADS: usize = 64;

    #[test]
    fn a_process_that_dials_again_and_again_returns_its_buffers() {
        if std::env::var_os(DIALS).is_some() {
            return dial();
        }
        let program = std::env::current_exe().unwrap();
        let output = Command::new(program)
            .args(["--exact", THIS])
            .env(DIALS, "1")
            .envs(SETTINGS.iter().copied())
            .output()
            .unwrap();
        let told = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && told.contains("1 passed"), "{told}");
    }

    /// Each thread takes a buffer and gives it back, one thread after the other.
    fn dial() {
        let before = resident();
        let all_run = Barrier::new(THREADS);
        let turn = std::sync::Mutex::new(());
        std::thread::scope(|scope| {
            for _ in 0..THREADS {
                scope.spawn(|| {
                    all_run.wait();
                    for _ in 0..2 {
                        let _own = turn.lock().unwrap();
                        std::hint::black_box(vec![1_u8; BUFFER]);
                    }
                    all_run.wait();
                });
            }
        });
        let grown = resident().saturating_sub(before);
        // 45 MiB and more with glibc's own settings.
        assert!(grown < 2 * BUFFER, "grown by {grown} bytes");
    }

    /// Resident memory that no file backs, bytes.
    fn resident() -> usize {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
        let kib: usize = line.trim().trim_end_matches(" kB").parse().unwrap();
        1024 * kib
    }
}
