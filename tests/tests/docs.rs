//! Does every command of the README and of `docs/` do what the page says? Each ```` ```sh ```` block is run unchanged beside one `zenav
//! up`, with the ports replaced by free ones; `CONTRIBUTING.md` describes the conventions.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use zenav_protocol::bus::{Bus, BusConfig};
use zenav_tests::deployment::ROBOT;
use zenav_tests::observer::Observer;
use zenav_tests::process::{Process, free_endpoint, run};

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");
/// Longest run of a command.
const LIMIT: Duration = Duration::from_secs(120);
/// Longest wait for the deployment.
const READY: Duration = Duration::from_secs(60);
/// Simulated seconds per second.
const SPEED: u32 = 6;
/// Commands that keep running by themselves.
const PARTS: [&str; 6] = [
    "zenav up",
    "zenav router",
    "zenav edge",
    "zenav cloud",
    "zenav gateway",
    "zenav sim serve",
];
/// Commands that already run, or must have run before this test.
const DONE: [&str; 4] = ["zenav up", "cargo test --workspace", "cargo build --release", ".ci/run"];
/// Ports named in the pages.
const ROUTER_PORT: &str = "7447";
const ROBOT_PORT: &str = "7450";
/// Port of a health endpoint in the pages; clients of any kind use it.
const HEALTH_PORT: &str = "9464";

/// A fenced block.
#[derive(Debug, PartialEq)]
struct Block {
    line: usize,
    language: String,
    /// The file that the block defines: `# NAME` or `<!-- NAME -->` in its first line, or `<!-- file: NAME -->` above the fence.
    file: Option<String>,
    /// Why the block is not run: `# not run: REASON` in its first lines.
    not_run: Option<String>,
    text: String,
}

fn blocks(page: &str) -> Vec<Block> {
    let lines: Vec<&str> = page.lines().collect();
    let mut found = Vec::new();
    let mut at = 0;
    while at < lines.len() {
        let Some(language) = lines[at].strip_prefix("```").map(str::trim) else {
            at += 1;
            continue;
        };
        let length = lines[at + 1..]
            .iter()
            .take_while(|line| !line.starts_with("```"))
            .count();
        let inside = &lines[at + 1..at + 1 + length];
        let above = lines[..at].last().copied().unwrap_or_default();
        let above = above
            .strip_prefix("<!-- file: ")
            .and_then(|rest| rest.strip_suffix(" -->"));
        let remarks = inside.iter().map_while(|line| remark(line));
        let not_run = remarks.clone().find_map(|remark| remark.strip_prefix("not run: "));
        let named = remarks.clone().next().filter(|name| is_file_name(name));
        found.push(Block {
            line: at + 1,
            language: language.to_owned(),
            file: above.or(named).map(str::to_owned),
            not_run: not_run.map(str::to_owned),
            text: inside.join("\n"),
        });
        at += length + 2;
    }
    found
}

/// The comment in a line that has nothing else.
fn remark(line: &str) -> Option<&str> {
    let xml = line.strip_prefix("<!-- ").and_then(|rest| rest.strip_suffix(" -->"));
    xml.or_else(|| line.strip_prefix("# "))
}

fn is_file_name(text: &str) -> bool {
    let is_plain = text
        .chars()
        .all(|letter| letter.is_ascii_alphanumeric() || "_-.".contains(letter));
    is_plain && text.contains('.') && !text.starts_with('.')
}

/// A command of a block, and its expected result.
#[derive(Debug, Default, PartialEq)]
struct Command {
    line: usize,
    script: String,
    /// `# keeps running`, or a part that does by itself: it runs until the end of the page.
    keeps_running: bool,
    /// `# exits N`.
    exits: i32,
    /// `#> TEXT` lines below it.
    output: Vec<String>,
}

fn commands(block: &Block) -> Vec<Command> {
    let mut found: Vec<Command> = Vec::new();
    let mut script = String::new();
    for (number, line) in block.text.lines().enumerate() {
        if let Some(expected) = line.strip_prefix("#>") {
            let last = found.last_mut().expect("a command above its output");
            last.output.push(expected.trim().to_owned());
            continue;
        }
        if script.is_empty() && (line.trim().is_empty() || line.starts_with('#')) {
            continue;
        }
        script.push_str(line);
        if let Some(begun) = script.strip_suffix('\\') {
            script = format!("{begun} ");
            continue;
        }
        let (code, comment) = script.rsplit_once(" # ").unwrap_or((&script, ""));
        let (code, comment) = (code.trim().to_owned(), comment.trim().to_owned());
        let exits = comment
            .strip_prefix("exits ")
            .and_then(|rest| rest.split([' ', ':']).next());
        let is_part = PARTS
            .iter()
            .any(|part| code == *part || code.starts_with(&format!("{part} ")));
        found.push(Command {
            line: block.line + 1 + number,
            keeps_running: is_part || comment.starts_with("keeps running"),
            exits: exits.map_or(0, |code| code.parse().expect("a number after `exits`")),
            output: Vec::new(),
            script: code,
        });
        script.clear();
    }
    found
}

/// Whether the output contains the lines in this order; `…` in a line matches anything.
fn is_in(expected: &[String], output: &str) -> Result<(), String> {
    let mut lines = output.lines();
    for wanted in expected {
        let parts: Vec<&str> = wanted.split('…').collect();
        let fits = |line: &str| {
            let mut rest = line;
            let all = parts.iter().all(|part| match rest.find(part.trim()) {
                Some(at) => {
                    rest = &rest[at + part.trim().len()..];
                    true
                }
                None => false,
            });
            let begins = line.trim_start().starts_with(parts.first().unwrap_or(&"").trim());
            all && begins
        };
        if !lines.any(fits) {
            return Err(format!("no line `{wanted}`"));
        }
    }
    Ok(())
}

/// Folder in which the commands of all pages run, beside one `zenav up`.
struct Place {
    folder: tempfile::TempDir,
    router: String,
    /// A free port instead of [`HEALTH_PORT`].
    health: String,
    /// Demonstrations already run: they take long, and two pages may show the same one.
    shown: BTreeSet<String>,
}

impl Place {
    fn new() -> Self {
        let place = Self {
            folder: tempfile::tempdir().unwrap(),
            router: free_endpoint(),
            health: free_endpoint().rsplit(':').next().unwrap().to_owned(),
            shown: BTreeSet::new(),
        };
        let (router, robot) = (place.router.as_str(), free_endpoint());
        let mut ports = String::new();
        for (port, endpoint) in [(ROUTER_PORT, router), (ROBOT_PORT, &robot)] {
            let free = endpoint.rsplit(':').next().unwrap();
            let _ = write!(ports, "s/:{port}\\b/:{free}/g;");
        }
        // Each argument is rewritten separately and keeps its spaces. Commands that use the default endpoint are given the deployment's.
        let zenav = format!(
            r#"#!/bin/sh
count=$#
while [ "$count" -gt 0 ]; do
    set -- "$@" "$(printf '%s' "$1" | sed '{ports}')"
    shift
    count=$((count - 1))
done
has() {{ case " $all " in *" $1 "*) true ;; *) false ;; esac }}
all="$*"
case "$1 $2" in
    "up "*) [ -n "$2" ] || export ZENAV_ROBOTS__{upper}__LISTEN={robot}
        export ZENAV_ROUTER__LISTEN='["{router}"]' ZENAV_BUS__CONNECT={router} ZENAV_SIMULATION__SPEED={SPEED} ;;
    "demo "*) has --speed || set -- "$@" --speed {SPEED} ;;
    "router "* | "sim serve") has --listen || set -- "$@" --listen {router} ;;
    "map load" | "map store" | "map reset" | "map hold" | "map resume" | "map list") has --connect || set -- "$@" --connect {router} ;;
    "map show" | "map save") case "$3" in *.yaml | *.png | *.pgm | *.map) ;; *) has --connect || set -- "$@" --connect {router} ;; esac ;;
    "do "* | "param "* | "place "* | "zone "* | "ask "* | \
    "edge "* | "cloud "* | "gateway "* | "goal "* | "stop "* | "resume "* | "teleop "* | "lease "* | "topic "* | "ps "* | "logs "* | "doctor "* | "bt watch" | "record "* | "replay "* | "pose "*)
        has --connect || set -- "$@" --connect {router} ;;
esac
exec {ZENAV} "$@"
"#,
            upper = ROBOT.to_uppercase(),
        );
        let cargo = "#!/bin/sh\n[ \"$1 $2 $3\" = 'run --release --' ] || { echo 'only cargo run --release -- is run here'; exit 1; }\nshift 3\nexec zenav \"$@\"\n";
        let bin = place.bin();
        std::fs::create_dir(&bin).unwrap();
        for (command, script) in [("zenav", zenav.as_str()), ("cargo", cargo)] {
            let file = bin.join(command);
            std::fs::write(&file, script).unwrap();
            std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o755)).unwrap();
        }
        place
    }

    fn bin(&self) -> PathBuf {
        self.folder.path().join(".bin")
    }

    fn script(&self, command: &str) -> String {
        let command = command.replace(&format!(":{HEALTH_PORT}"), &format!(":{}", self.health));
        format!("PATH={}:$PATH\nset -e\n{command}", self.bin().display())
    }

    fn start(&self, command: &str) -> Process {
        let script = self.script(&format!("exec {command}"));
        Process::start("sh", &["-c", &script], self.folder.path())
    }

    /// Starts the deployment for all pages, and waits until its mission commands the robot.
    async fn up(&self) -> Process {
        let up = self.start("zenav up");
        let opening = Bus::open(BusConfig::service("docs", &self.router));
        let bus = tokio::time::timeout(READY, opening)
            .await
            .expect("the router listens")
            .unwrap();
        let mut robot = Observer::new(&bus, ROBOT);
        robot
            .until("a mission commands the robot", READY, |state| state.lease.live)
            .await;
        bus.close().await;
        up
    }

    /// Runs a block; returns the processes that keep running.
    fn run(&mut self, page: &str, block: &Block) -> Vec<Process> {
        let mut running = Vec::new();
        for command in commands(block) {
            let at = format!("{page}:{}: {}", command.line, command.script);
            let is_done = DONE.contains(&command.script.as_str());
            let is_demo = command.script.contains(" demo ");
            if is_done || (is_demo && !self.shown.insert(command.script.clone())) {
                continue;
            }
            eprintln!("{at}");
            if command.keeps_running {
                running.push(self.start(&command.script));
                continue;
            }
            let script = self.script(&command.script);
            let done = tokio::task::block_in_place(|| run("sh", &["-c", &script], self.folder.path(), LIMIT));
            let (stdout, stderr) = (
                String::from_utf8_lossy(&done.stdout),
                String::from_utf8_lossy(&done.stderr),
            );
            assert_eq!(done.status.code(), Some(command.exits), "{at}\n{stdout}\n{stderr}");
            let found = is_in(&command.output, &stdout);
            assert!(found.is_ok(), "{at}: {}\n{stdout}\n{stderr}", found.unwrap_err());
        }
        running
    }
}

/// The README and every page of `docs/`.
fn pages() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let mut pages = vec![root.join("README.md")];
    let mut folders = vec![root.join("docs")];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(&folder) else {
            continue;
        };
        for path in entries.map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "md") {
                pages.push(path);
            }
        }
    }
    pages.sort();
    pages
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn every_command_of_the_docs_does_what_its_page_says() {
    let mut place = Place::new();
    let mut up = place.up().await;
    let (mut run, mut not_run) = (0, Vec::new());
    for path in pages() {
        let text = std::fs::read_to_string(&path).unwrap();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let mut running = Vec::new();
        for block in blocks(&text) {
            if let Some(file) = &block.file {
                std::fs::write(place.folder.path().join(file), &block.text).unwrap();
            } else if let Some(reason) = &block.not_run {
                not_run.push(format!("{name}:{}: {reason}", block.line));
            } else if block.language == "sh" {
                running.extend(place.run(&name, &block));
                run += 1;
            }
        }
        running.iter_mut().for_each(Process::assert_running);
    }
    up.assert_running();
    eprintln!("{run} blocks run; {} not run:\n{}", not_run.len(), not_run.join("\n"));
    assert!(run > 0, "the docs have commands");
}

#[test]
fn blocks_commands_and_outputs_are_read_as_the_conventions_say() {
    let page = "text\n```toml\n# a.toml\n# not run: it is a file\nx = 1\n```\n```sh\nzenav topic hz edge/scan   # keeps running\n\nzenav goal \\\nlist\n\
                #> goal … Succeeded\n# a remark\nzenav x; zenav y # exits 7: refused\n```\n```sh\n# not run: long\nz\n```\n\
                <!-- file: s.json -->\n```json\n{}\n```\n";
    let found = blocks(page);
    assert_eq!(found.len(), 4);
    assert_eq!(found[0].file.as_deref(), Some("a.toml"));
    assert_eq!((found[1].file.as_deref(), found[1].not_run.as_deref()), (None, None));
    assert_eq!(found[2].not_run.as_deref(), Some("long"));
    assert_eq!(found[3].file.as_deref(), Some("s.json"));
    let commands = commands(&found[1]);
    assert_eq!(commands.len(), 3);
    assert!(commands[0].keeps_running && !commands[1].keeps_running);
    assert_eq!(
        (commands[1].script.as_str(), commands[1].line),
        ("zenav goal  list", 11)
    );
    assert_eq!((commands[2].exits, commands[1].exits), (7, 0));
    let output = &commands[1].output;
    assert_eq!(*output, ["goal … Succeeded"]);
    assert!(is_in(output, "head\n  goal 7 Succeeded\n").is_ok());
    assert!(is_in(output, "goal 7 Aborted").is_err() && is_in(output, "the goal 7 Succeeded").is_err());
}
