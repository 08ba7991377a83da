//! Corrupted files: is a modified goal store or map ever trusted?

use std::path::PathBuf;

use zenav_tests::deployment::{Deployment, ROBOT};

use super::{LONG, ZENAV, drive, said};

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn an_emptied_or_torn_goal_store_is_refused_by_name_and_a_torn_map_or_one_with_other_numbers_begins_anew() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let mut up = deployment.start_up();
    deployment.bus().await.close().await;
    drive(&deployment, "-0.9", "-0.2");
    let saved = deployment.client(&["map", "store"]);
    up.interrupt(LONG).unwrap();
    let files: PathBuf = deployment.folder().join("up").join(ROBOT);

    let picture = files.join("map.pgm");
    let whole = std::fs::read(&picture).unwrap_or_else(|error| panic!("{error}: {}", said(&saved)));
    std::fs::write(&picture, &whole[..whole.len() / 2]).unwrap();
    let mut up = deployment.start_up();
    let line = up.until("mapping begins a new one", LONG);
    assert!(line.contains("map.pgm") && line.contains("truncated"), "{line}");
    up.interrupt(LONG).unwrap();
    std::fs::write(&picture, whole).unwrap();

    let yaml = files.join("map.yaml");
    let text = std::fs::read_to_string(&yaml).unwrap();
    let spoiled = text.replace("resolution: 0.025", "resolution: 0.5");
    assert_ne!(spoiled, text);
    std::fs::write(&yaml, spoiled).unwrap();
    let mut up = deployment.start_up();
    let line = up.until("mapping begins a new one", LONG);
    assert!(line.contains("map.yaml") && line.contains("do not fit"), "{line}");
    deployment.bus().await.close().await;
    drive(&deployment, "-0.9", "0.3");
    up.interrupt(LONG).unwrap();

    let store = files.join("mission.redb");
    let whole = std::fs::read(&store).unwrap();
    for (left, why) in [(0, "mission.redb: an empty file"), (whole.len() / 2, "mission.redb")] {
        std::fs::write(&store, &whole[..left]).unwrap();
        let refused = deployment.zenav(&["up", "deployment.toml"]);
        assert_ne!(refused.status.code(), Some(0));
        assert!(said(&refused).contains(why), "{}", said(&refused));
    }
}
