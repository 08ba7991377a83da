//! A full disk, or one that turns read-only: which parts keep running, what is reported, and what is stored once it can be written again?
//!
//! A file size limit stands in for the full disk: it needs no privileges, and can be lifted from outside. A disk that turns read-only is a file
//! system of its own.

use std::path::{Path, PathBuf};

use rustix::process::{Pid, Resource, Rlimit};
use zenav_protocol::messages::Mode;
use zenav_tests::deployment::{Deployment, ROBOT};
use zenav_tests::observer::Observer;
use zenav_tests::process::{Process, run};

use super::{LONG, ZENAV, drive, said};

/// Starts a command for which a failing write returns an error instead of raising a signal; with or without space at first.
fn start(arguments: &[&str], folder: &Path, room: bool) -> Process {
    let limit = if room { "" } else { "ulimit -S -f 0;" };
    let script = format!("trap '' XFSZ; {limit} exec \"$0\" \"$@\"");
    Process::start("sh", &[&["-c", &script, ZENAV], arguments].concat(), folder)
}

/// Allows or forbids a process to write files.
fn set_room(process: &Process, room: bool) {
    let pid = Pid::from_raw(i32::try_from(process.id()).unwrap());
    let current = if room { None } else { Some(0) };
    rustix::process::prlimit(pid, Resource::Fsize, Rlimit { current, maximum: None }).unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_mission_on_a_full_disk_acknowledges_nothing_lives_and_goes_on_when_there_is_room() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let _router = deployment.start_router();
    deployment.bus().await.close().await;
    let _edge = deployment.start_edge();
    let arguments = [
        "cloud",
        "all",
        "--connect",
        &deployment.router,
        "--data",
        "cloud",
        "--world",
        "kitchen",
    ];
    let mut cloud = start(&arguments, deployment.folder(), true);
    drive(&deployment, "-0.9", "-0.2");

    set_room(&cloud, false);
    let submit = ["goal", "submit", "-0.9", "0.3", "--id", "full", "--timeout", "10"];
    let refused = deployment.client(&submit);
    assert_ne!(refused.status.code(), Some(0), "{}", said(&refused));
    assert!(said(&refused).contains("nothing can be stored"), "{}", said(&refused));
    assert!(
        said(&refused).contains("mission.redb"),
        "it names the file: {}",
        said(&refused)
    );
    cloud.until("waits for room", LONG);
    cloud.assert_running();
    let health = said(&deployment.client(&["doctor"]));
    assert!(
        health.contains("stores no goals") && health.contains("make room on that disk"),
        "{health}"
    );
    assert!(!health.contains("lease forget"), "its goals are not lost: {health}");

    set_room(&cloud, true);
    let done = deployment.client(&[&submit[..6], &["--wait", "--timeout", "40"]].concat());
    assert_eq!(done.status.code(), Some(0), "{}", said(&done));
    cloud.assert_running();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_mission_that_starts_on_a_full_disk_shows_why_it_refuses_and_goes_on_when_there_is_room() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let _router = deployment.start_router();
    deployment.bus().await.close().await;
    let _edge = deployment.start_edge();
    let arguments = ["cloud", "mission", "--connect", &deployment.router, "--data", "cloud"];
    let mut cloud = start(&arguments, deployment.folder(), false);
    cloud.until("waits for room", LONG);
    let shown = said(&deployment.client(&["ps"]));
    assert!(shown.contains("mission, without room"), "{shown}");
    let health = said(&deployment.client(&["doctor"]));
    assert!(
        health.contains("stores no goals") && health.contains("mission.redb"),
        "{health}"
    );
    let submit = ["goal", "submit", "-0.9", "0.3", "--id", "full", "--timeout", "10"];
    let refused = said(&deployment.client(&submit));
    assert!(refused.contains("nothing can be stored"), "{refused}");

    set_room(&cloud, true);
    let accepted = deployment.client(&[&submit[..6], &["--timeout", "40"]].concat());
    assert_eq!(accepted.status.code(), Some(0), "{}", said(&accepted));
    cloud.assert_running();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn an_edge_on_a_full_disk_starts_obeys_a_stop_says_that_it_is_not_stored_and_stores_it_when_there_is_room() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let _router = deployment.start_router();
    let bus = deployment.bus().await;
    let mut robot = Observer::new(&bus, ROBOT);
    let arguments = [
        "edge",
        "--connect",
        &deployment.router,
        "--listen",
        &deployment.edge,
        "--data",
        "edge",
        "--world",
        "kitchen",
    ];
    let mut edge = start(&arguments, deployment.folder(), false);
    robot
        .until("it says so", LONG, |state| state.faults.storage.is_some())
        .await;
    let stopped = deployment.client(&["stop", "--timeout", "20"]);
    assert_eq!(stopped.status.code(), Some(0), "{}", said(&stopped));
    assert!(said(&stopped).contains("not stored"), "{}", said(&stopped));
    let lease = deployment.client(&["lease", "acquire", "--for", "1", "--timeout", "5"]);
    assert_ne!(
        lease.status.code(),
        Some(0),
        "an epoch must not come twice: {}",
        said(&lease)
    );
    let health = said(&deployment.client(&["doctor"]));
    assert!(health.contains("not stored"), "{health}");
    robot
        .until("it is stopped", LONG, |state| {
            state.mode == Mode::Stopped && state.faults.storage.is_some()
        })
        .await;

    set_room(&edge, true);
    robot
        .until("it is stored", LONG, |state| state.faults.storage.is_none())
        .await;
    edge.kill();
    let _edge = deployment.start_edge();
    let state = robot
        .until("it runs again", LONG, |state| state.stamp.as_secs() < 5.0)
        .await;
    assert_eq!(state.mode, Mode::Stopped);
}

/// A disk in a file. It turns read-only under open files, as a disk does that reports errors.
struct Disk {
    image: PathBuf,
    folder: PathBuf,
}

impl Disk {
    /// Formats and mounts a disk in a new folder of this name.
    fn new(beside: &Path, name: &str) -> Self {
        let disk = Self {
            image: beside.join(format!("{name}.img")),
            folder: beside.join(name),
        };
        let image = std::fs::File::create(&disk.image).unwrap();
        image.set_len(64 * 1024 * 1024).unwrap();
        std::fs::create_dir(&disk.folder).unwrap();
        disk.command("mkfs.ext4", &["-q"], &[&disk.image]);
        disk.mount();
        disk
    }

    fn mount(&self) {
        self.command("mount", &["-o", "loop,errors=remount-ro"], &[&self.image, &self.folder]);
    }

    fn command(&self, program: &str, options: &[&str], paths: &[&Path]) -> String {
        let paths: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
        let arguments: Vec<&str> = options
            .iter()
            .copied()
            .chain(paths.iter().map(String::as_str))
            .collect();
        let output = run(program, &arguments, Path::new("/"), LONG);
        assert!(output.status.success(), "{program} {arguments:?}: {}", said(&output));
        said(&output)
    }

    /// An error: the kernel lets nobody write any more.
    fn fail(&self) {
        let device = self.command("findmnt", &["-n", "-o", "SOURCE"], &[&self.folder]);
        let device = device.trim().rsplit('/').next().unwrap();
        std::fs::write(format!("/sys/fs/ext4/{device}/trigger_fs_error"), "1").unwrap();
    }

    /// Mounts it anew, as after a restart of the machine; nobody may use it.
    fn repair(&self) {
        self.command("umount", &[], &[&self.folder]);
        self.mount();
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let folder = self.folder.display().to_string();
        let _ = run("umount", &["-l", &folder], Path::new("/"), LONG);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
#[ignore = "needs root, a loop device and mkfs.ext4"]
async fn on_a_disk_that_turns_read_only_nothing_is_acknowledged_and_what_was_is_still_there_afterwards() {
    let deployment = Deployment::new(ZENAV, "kitchen", 4.0);
    let disk = Disk::new(deployment.folder(), "disk");
    let _router = deployment.start_router();
    deployment.bus().await.close().await;
    let _edge = deployment.start_edge();
    let mut cloud = deployment.start_service_in("all", "disk");
    drive(&deployment, "-0.9", "-0.2");
    let stored = deployment.client(&["map", "store", "before"]);
    assert_eq!(stored.status.code(), Some(0), "{}", said(&stored));

    disk.fail();
    let submit = ["goal", "submit", "-0.9", "0.3", "--id", "late", "--timeout", "10"];
    let refused = deployment.client(&submit);
    assert_ne!(refused.status.code(), Some(0), "{}", said(&refused));
    assert!(said(&refused).contains("nothing can be stored"), "{}", said(&refused));
    cloud.until("waits for room", LONG);
    let health = said(&deployment.client(&["doctor"]));
    assert!(
        health.contains("stores no goals") && health.contains("Read-only file system"),
        "{health}"
    );
    let unsaved = deployment.client(&["map", "store", "after"]);
    assert!(
        unsaved.status.code() != Some(0) && said(&unsaved).contains("Read-only file system"),
        "{}",
        said(&unsaved)
    );
    cloud.assert_running();

    cloud.kill();
    disk.repair();
    cloud = deployment.start_service_in("all", "disk");
    let done = deployment.client(&[&submit[..6], &["--wait", "--timeout", "40"]].concat());
    assert_eq!(done.status.code(), Some(0), "{}", said(&done));
    let listed = deployment.client(&["goal", "list", "-o", "json"]);
    let goals: Vec<serde_json::Value> = serde_json::from_slice(&listed.stdout).unwrap();
    assert_eq!(goals.len(), 2, "{}", said(&listed));
    assert!(
        goals.iter().all(|goal| goal["state"] == "Succeeded"),
        "{}",
        said(&listed)
    );
    let maps = said(&deployment.client(&["map", "list"]));
    assert!(maps.contains("before") && !maps.contains("after"), "{maps}");
    cloud.assert_running();
}
