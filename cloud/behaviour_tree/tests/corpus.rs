//! Arbitrary bytes are either a tree that runs, or refused: the fuzzer's corpus, whole and cut to pieces.
#![cfg(feature = "nav2")]
#![allow(missing_docs, clippy::unwrap_used, reason = "tests")]

use std::time::Duration;

use proptest::prelude::*;
use zenav_behaviour_tree::Status;

mod exercise;
#[path = "../benches/trees/mod.rs"]
mod trees;

use exercise::exercise;

/// The fuzzer's initial files.
fn corpus() -> Vec<(String, Vec<u8>)> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fuzz/corpus/tree");
    let mut files: Vec<(String, Vec<u8>)> = std::fs::read_dir(folder)
        .unwrap()
        .map(|file| file.unwrap())
        .map(|file| {
            (
                file.file_name().to_string_lossy().into_owned(),
                std::fs::read(file.path()).unwrap(),
            )
        })
        .collect();
    files.sort();
    files
}

#[test]
fn every_file_of_the_corpus_is_run_or_refused() {
    let files = corpus();
    assert!(files.len() > 40);
    for (name, bytes) in files {
        let ran = exercise(&bytes);
        let refused = name.starts_with("bad_");
        let missing = name == "include.xml";
        assert_eq!(ran.is_err(), refused || missing, "{name}: {ran:?}");
    }
}

proptest! {
    /// Imitates the fuzzer without its compiler: pieces of the corpus in another order.
    #[test]
    fn cut_and_joined_files_are_run_or_refused(
        files in prop::collection::vec((any::<prop::sample::Index>(), 0.0..1.0, 0.0..1.0), 1..4),
        noise in prop::collection::vec((0.0..1.0, any::<u8>()), 0..4),
    ) {
        let corpus = corpus();
        let mut bytes = Vec::new();
        for (file, from, to) in files {
            let (_, text) = file.get(&corpus);
            let at = |share: f64| (share * text.len() as f64) as usize;
            let (from, to): (usize, usize) = (at(f64::min(from, to)), at(f64::max(from, to)));
            bytes.extend_from_slice(&text[from..to]);
        }
        for (place, byte) in noise {
            let at = (place * bytes.len() as f64) as usize;
            if let Some(changed) = bytes.get_mut(at) {
                *changed = byte;
            }
        }
        let _ = exercise(&bytes);
    }
}

#[test]
fn every_tick_of_the_tree_that_is_measured_visits_every_node() {
    for nodes in [10, 30, 1000] {
        let mut tree = trees::reactive_tree(nodes).unwrap();
        assert!(tree.len().abs_diff(nodes) <= 1, "{} {nodes}", tree.len());
        for tick in 1..4 {
            assert_eq!(tree.tick(Duration::ZERO, &mut 0), Ok(Status::Running));
            let visited = tree
                .iter()
                .all(|node| node.starts == tick || node.status == Status::Running);
            assert!(visited);
        }
    }
}
