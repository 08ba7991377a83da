//! Does every command of the README and of `docs/` do what the page says? Each ```` ```sh ```` block is run unchanged beside one `zenav
//! up`, with the ports replaced by free ones; `CONTRIBUTING.md` describes the conventions. Blocks for programs that are not zenav's
//! (`# needs zenoh-cli`) are run by a test of their own.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Output;
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
const DONE: [&str; 5] = [
    "zenav up",
    "cargo test --workspace",
    "cargo test -p zenav-model",
    "cargo build --release",
    ".ci/run",
];
/// Ports named in the pages: those of the deployment's router, robot, page and REST.
const ROUTER_PORT: &str = "7447";
const ROBOT_PORT: &str = "7450";
const PAGE_PORT: &str = "7480";
const REST_PORT: &str = "8000";
/// Other ports named in the pages: of a second router, and of a health endpoint.
const OTHER_PORTS: [&str; 2] = ["7460", "9464"];
/// Programs that blocks need: name, what succeeds where it is there, and how to get it.
const TOOLS: [(&str, &str, &str); 3] = [
    ("curl", "curl --version", "apt-get install curl"),
    ("zenoh-cli", "zenoh --help", "PYTHON -m pip install zenoh-cli"),
    (
        "eclipse-zenoh",
        "python3 -c 'import zenoh'",
        "PYTHON -m pip install eclipse-zenoh",
    ),
];

/// A fenced block.
#[derive(Debug, PartialEq)]
struct Block {
    line: usize,
    language: String,
    /// The file that the block defines: `# NAME` or `<!-- NAME -->` in its first line, or `<!-- file: NAME -->` above the fence.
    file: Option<String>,
    /// Why the block is not run: `# not run: REASON` in its first lines.
    not_run: Option<String>,
    /// Programs that the block needs: `# needs NAME, NAME` in its first lines.
    needs: Vec<String>,
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
        let needs = remarks.clone().find_map(|remark| remark.strip_prefix("needs "));
        let named = remarks.clone().next().filter(|name| is_file_name(name));
        found.push(Block {
            line: at + 1,
            language: language.to_owned(),
            file: above.or(named).map(str::to_owned),
            not_run: not_run.map(str::to_owned),
            needs: needs.map_or_else(Vec::new, |names| names.split(", ").map(str::to_owned).collect()),
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
    /// A free port for each port named in the pages.
    ports: BTreeMap<&'static str, String>,
    /// Demonstrations already run: they take long, and two pages may show the same one.
    shown: BTreeSet<String>,
}

impl Place {
    fn new() -> Self {
        let named = [ROUTER_PORT, ROBOT_PORT, PAGE_PORT, REST_PORT]
            .into_iter()
            .chain(OTHER_PORTS);
        let place = Self {
            folder: tempfile::tempdir().unwrap(),
            ports: named.map(|port| (port, free_port())).collect(),
            shown: BTreeSet::new(),
        };
        let [robot, page, rest] = [ROBOT_PORT, PAGE_PORT, REST_PORT].map(|port| place.ports[port].as_str());
        // Commands that use the default endpoint are given the deployment's. A deployment of a block's own takes free ports.
        let zenav = format!(
            r#"#!/bin/sh
has() {{ case " $all " in *" $1 "*) true ;; *) false ;; esac }}
all="$*"
case "$1 $2" in
    "up ") export ZENAV_ROUTER__LISTEN="[\"$ROUTER\"]" ZENAV_BUS__CONNECT="$ROUTER" ZENAV_SIMULATION__SPEED={SPEED}
        export ZENAV_ROBOTS__{upper}__LISTEN=tcp/127.0.0.1:{robot} ZENAV_GATEWAY__LISTEN=127.0.0.1:{page} ZENAV_ROUTER__REST=127.0.0.1:{rest} ;;
    "up "*) export ZENAV_ROUTER__LISTEN="[\"$ROUTER\"]" ZENAV_BUS__CONNECT="$ROUTER" ZENAV_GATEWAY__LISTEN=127.0.0.1:0
        ZENAV_DATA__DIR=$(mktemp -d ./up.XXXXXX) && export ZENAV_DATA__DIR
        case "$2" in --*) export ZENAV_ROBOTS__{upper}__LISTEN=tcp/127.0.0.1:0 ;; esac ;;
    "demo "*) has --speed || set -- "$@" --speed {SPEED} ;;
    "router "* | "sim serve") has --listen || set -- "$@" --listen "$ROUTER" ;;
    "map load" | "map store" | "map reset" | "map hold" | "map resume" | "map list" | "map watch") has --connect || set -- "$@" --connect "$ROUTER" ;;
    "map show" | "map save") case "$3" in *.yaml | *.png | *.pgm | *.map) ;; *) has --connect || set -- "$@" --connect "$ROUTER" ;; esac ;;
    "view "*) has --listen || set -- "$@" --listen 127.0.0.1:0
        has --connect || set -- "$@" --connect "$ROUTER" ;;
    "do "* | "param "* | "place "* | "zone "* | "ask "* | \
    "edge "* | "cloud "* | "gateway "* | "goal "* | "stop "* | "resume "* | "teleop "* | "lease "* | "topic "* | "ps "* | "logs "* | "doctor "* | "bt watch" | "record "* | "replay "* | "pose "*)
        has --connect || set -- "$@" --connect "$ROUTER" ;;
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

    fn router(&self) -> String {
        format!("tcp/127.0.0.1:{}", self.ports[ROUTER_PORT])
    }

    /// A text of a page with the ports of this test.
    fn local(&self, text: &str) -> String {
        self.ports.iter().fold(text.to_owned(), |text, (named, free)| {
            text.replace(&format!(":{named}"), &format!(":{free}"))
        })
    }

    /// Programs are found beside zenav's, then beside the Python of `PYTHON`, then as usual.
    fn script(&self, command: &str) -> String {
        let python = PathBuf::from(std::env::var_os("PYTHON").unwrap_or_default());
        let (bin, beside) = (self.bin(), python.parent().unwrap_or(Path::new("")));
        let path = format!("{}:{}:$PATH", bin.display(), beside.display());
        let (router, command) = (self.router(), self.local(command));
        format!("PATH=\"{path}\"\nexport ROUTER={router}\nset -e\n{command}")
    }

    fn start(&self, command: &str) -> Process {
        let script = self.script(&format!("exec {command}"));
        Process::start("sh", &["-c", &script], self.folder.path())
    }

    fn finish(&self, command: &str) -> Output {
        let script = self.script(command);
        tokio::task::block_in_place(|| run("sh", &["-c", &script], self.folder.path(), LIMIT))
    }

    /// Starts the deployment for all pages, and waits until its mission commands the robot.
    async fn up(&self, command: &str) -> Process {
        let up = self.start(command);
        let opening = Bus::open(BusConfig::service("docs", &self.router()));
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
        let (mut running, mut own) = (Vec::new(), None);
        for command in commands(block) {
            let at = format!("{page}:{}: {}", command.line, command.script);
            let is_done = DONE.contains(&command.script.as_str());
            let is_demo = command.script.contains(" demo ");
            if is_done || (is_demo && !self.shown.insert(command.script.clone())) {
                continue;
            }
            eprintln!("{at}");
            if command.script.starts_with("zenav up ") {
                // The commands below are for this deployment, which ends with the block.
                let main = self.ports.insert(ROUTER_PORT, free_port());
                let mut up = self.start(&command.script);
                up.until("ready in", READY);
                own = Some((main, up));
                continue;
            }
            if command.keeps_running {
                let mut process = self.start(&command.script);
                if command.script.starts_with("zenav router ") {
                    process.until("router up", READY);
                }
                running.push(process);
                continue;
            }
            let done = self.finish(&command.script);
            let (stdout, stderr) = (
                String::from_utf8_lossy(&done.stdout),
                String::from_utf8_lossy(&done.stderr),
            );
            assert_eq!(done.status.code(), Some(command.exits), "{at}\n{stdout}\n{stderr}");
            let expected: Vec<String> = command.output.iter().map(|line| self.local(line)).collect();
            let found = is_in(&expected, &stdout);
            assert!(found.is_ok(), "{at}: {}\n{stdout}\n{stderr}", found.unwrap_err());
        }
        if let Some((Some(main), _up)) = own {
            self.ports.insert(ROUTER_PORT, main);
        }
        running
    }
}

fn free_port() -> String {
    free_endpoint().rsplit(':').next().unwrap().to_owned()
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

/// Runs the blocks of all pages beside a deployment: those that need other programs, or all others.
async fn run_blocks(up: &str, with_tools: bool) {
    let mut place = Place::new();
    let mut up = place.up(up).await;
    let (mut run, mut not_run) = (0, Vec::new());
    for path in pages() {
        let text = std::fs::read_to_string(&path).unwrap();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let mut running = Vec::new();
        for block in blocks(&text) {
            let at = format!("{name}:{}", block.line);
            if let Some(file) = &block.file {
                std::fs::write(place.folder.path().join(file), place.local(&block.text)).unwrap();
            } else if let Some(reason) = &block.not_run {
                not_run.push(format!("{at}: {reason}"));
            } else if block.language == "sh" && block.needs.is_empty() == with_tools {
                not_run.push(format!("{at}: by the other test"));
            } else if block.language == "sh" {
                for (tool, works, how) in TOOLS {
                    let is_needed = block.needs.iter().any(|needed| needed == tool);
                    let is_there = !is_needed || place.finish(works).status.success();
                    assert!(is_there, "{at} needs {tool}: {how}");
                }
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

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn every_command_of_the_docs_does_what_its_page_says() {
    run_blocks("zenav up", false).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
#[ignore = "needs curl, and a Python with eclipse-zenoh and zenoh-cli, which .ci/run installs: PYTHON=… cargo test -p zenav-tests --test docs -- --ignored"]
async fn curl_python_and_zenoh_s_own_tools_see_and_command_a_robot_as_the_docs_say() {
    run_blocks("env ZENAV_ROUTER__SCOUTING=true zenav up", true).await;
}

#[test]
fn blocks_commands_and_outputs_are_read_as_the_conventions_say() {
    let page = "text\n```toml\n# a.toml\n# not run: it is a file\nx = 1\n```\n```sh\nzenav topic hz edge/scan   # keeps running\n\nzenav goal \\\nlist\n\
                #> goal … Succeeded\n# a remark\nzenav x; zenav y # exits 7: refused\n```\n```sh\n# not run: long\nz\n```\n\
                ```sh\n# needs curl, zenoh-cli\ncurl x\n```\n<!-- file: s.json -->\n```json\n{}\n```\n";
    let found = blocks(page);
    assert_eq!(found.len(), 5);
    assert_eq!(found[0].file.as_deref(), Some("a.toml"));
    assert_eq!((found[1].file.as_deref(), found[1].not_run.as_deref()), (None, None));
    assert_eq!(found[2].not_run.as_deref(), Some("long"));
    assert!(found[3].needs == ["curl", "zenoh-cli"] && found[3].not_run.is_none() && found[2].needs.is_empty());
    assert!(
        found[3]
            .needs
            .iter()
            .all(|tool| TOOLS.iter().any(|(name, ..)| name == tool))
    );
    assert_eq!(found[4].file.as_deref(), Some("s.json"));
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
