//! Does every command of the README and of `docs/` do what the page says? Each ```` ```sh ```` block is run as it stands, in a folder of its
//! page, with the ports replaced by free ones; `CONTRIBUTING.md` has the conventions.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

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
/// Longest wait for what keeps running to be ready.
const READY: Duration = Duration::from_secs(30);
/// Ports that the pages name.
const ROUTER_PORT: &str = "7447";
const ROBOT_PORT: &str = "7450";

/// A fenced block.
#[derive(Debug, PartialEq)]
struct Block {
    line: usize,
    language: String,
    /// What the comment above the fence says: `<!-- not run: REASON -->`, `<!-- file: NAME -->`.
    comment: Option<(String, String)>,
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
        let above = lines[..at].last().copied().unwrap_or_default();
        let comment = above.strip_prefix("<!-- ").and_then(|rest| rest.strip_suffix(" -->"));
        found.push(Block {
            line: at + 1,
            language: language.to_owned(),
            comment: comment
                .and_then(|comment| comment.split_once(": "))
                .map(|(key, value)| (key.to_owned(), value.to_owned())),
            text: lines[at + 1..at + 1 + length].join("\n"),
        });
        at += length + 2;
    }
    found
}

/// A command of a block, and what is expected of it.
#[derive(Debug, Default, PartialEq)]
struct Command {
    line: usize,
    script: String,
    /// `# keeps running`: it goes on until the page's end.
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
        let comment = script.rsplit_once(" # ").map_or("", |(_, comment)| comment).trim();
        let exits = comment
            .strip_prefix("exits ")
            .and_then(|rest| rest.split([' ', ':']).next());
        found.push(Command {
            line: block.line + 1 + number,
            keeps_running: comment.starts_with("keeps running"),
            exits: exits.map_or(0, |code| code.parse().expect("a number after `exits`")),
            output: Vec::new(),
            script: std::mem::take(&mut script),
        });
    }
    found
}

/// Whether the lines stand in the output in this order; `…` in one stands for anything.
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
        if !lines.any(|line| fits(line)) {
            return Err(format!("no line `{wanted}`"));
        }
    }
    Ok(())
}

/// A folder in which a page's commands run.
struct Page {
    name: String,
    folder: tempfile::TempDir,
    router: String,
    running: Vec<Process>,
}

impl Page {
    fn new(name: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let page = Self {
            name: name.to_owned(),
            folder,
            router: free_endpoint(),
            running: Vec::new(),
        };
        let (router, robot) = (page.router.as_str(), free_endpoint());
        let mut ports = String::new();
        for (port, endpoint) in [(ROUTER_PORT, router), (ROBOT_PORT, &robot)] {
            let free = endpoint.rsplit(':').next().unwrap();
            let _ = write!(ports, "s/:{port}\\b/:{free}/g;");
        }
        // Arguments keep their spaces: each is rewritten by itself. Commands that connect by default are told where to.
        let zenav = format!(
            r#"#!/bin/sh
count=$#
while [ "$count" -gt 0 ]; do
    set -- "$@" "$(printf '%s' "$1" | sed '{ports}')"
    shift
    count=$((count - 1))
done
case " $* " in *" --connect "*) connects=yes ;; *) connects= ;; esac
case "$1 $2" in
    "up "*) [ -n "$2" ] || export ZENAV_ROBOTS__{upper}__LISTEN={robot}
        export ZENAV_ROUTER__LISTEN='["{router}"]' ZENAV_BUS__CONNECT={router} ZENAV_SIMULATION__SPEED=4 ;;
    "router "* | "sim serve") set -- "$@" --listen {router} ;;
    "edge "* | "cloud "* | "goal "* | "stop "* | "resume "* | "teleop "* | "lease "* | "topic "* | "doctor "* | "bt watch" | "map show" | "map save")
        [ -n "$connects" ] || set -- "$@" --connect {router} ;;
esac
exec {ZENAV} "$@"
"#,
            upper = ROBOT.to_uppercase(),
        );
        let cargo = "#!/bin/sh\n[ \"$1 $2 $3\" = 'run --release --' ] || { echo \"only cargo run --release -- is run here\"; exit 1; }\nshift 3\nexec zenav \"$@\"\n";
        let bin = page.bin();
        std::fs::create_dir(&bin).unwrap();
        for (command, script) in [("zenav", zenav.as_str()), ("cargo", cargo)] {
            let file = bin.join(command);
            std::fs::write(&file, script).unwrap();
            std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o755)).unwrap();
        }
        page
    }

    fn bin(&self) -> PathBuf {
        self.folder.path().join(".bin")
    }

    fn script(&self, command: &str) -> String {
        format!("PATH={}:$PATH\nset -e\n{command}", self.bin().display())
    }

    async fn run(&mut self, block: &Block) {
        for command in commands(block) {
            let at = format!("{}:{}: {}", self.name, command.line, command.script);
            eprintln!("{at}");
            if command.keeps_running {
                let script = self.script(&format!("exec {}", command.script));
                self.running
                    .push(Process::start("sh", &["-c", &script], self.folder.path()));
                self.wait(&at, command.script.starts_with("zenav up")).await;
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
        for process in &mut self.running {
            process.assert_running();
        }
    }

    /// Until somebody answers at the router, and a mission leads where a whole deployment was started.
    async fn wait(&mut self, at: &str, is_deployment: bool) {
        let opening = Bus::open(BusConfig::service("docs", &self.router));
        let opened = tokio::time::timeout(READY, opening).await;
        let bus = opened.unwrap_or_else(|_| panic!("{at}: nobody listens")).unwrap();
        if is_deployment {
            let mut robot = Observer::new(&bus, ROBOT);
            robot
                .until("a mission commands the robot", READY, |state| state.lease.live)
                .await;
        }
        bus.close().await;
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
    let (mut run, mut left_out) = (0, Vec::new());
    for path in pages() {
        let text = std::fs::read_to_string(&path).unwrap();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let mut page = Page::new(&name);
        for block in blocks(&text) {
            match &block.comment {
                Some((key, reason)) if key == "not run" => left_out.push(format!("{name}:{}: {reason}", block.line)),
                Some((key, file)) if key == "file" => {
                    assert!(!file.contains(['/', '\\']), "{name}: a file in the folder: {file}");
                    std::fs::write(page.folder.path().join(file), &block.text).unwrap();
                }
                _ if block.language == "sh" => {
                    page.run(&block).await;
                    run += 1;
                }
                _ => {}
            }
        }
    }
    eprintln!("{run} blocks run; {} not run:\n{}", left_out.len(), left_out.join("\n"));
    assert!(run > 0, "the docs have commands");
}

#[test]
fn blocks_commands_and_outputs_are_read_as_the_conventions_say() {
    let page = "text\n<!-- file: a.toml -->\n```toml\nx = 1\n```\n```sh\nzenav up   # keeps running, until Ctrl-C\n\nzenav goal \\\nlist\n\
                #> goal … Succeeded\n# a remark\nzenav x; zenav y # exits 7: refused\n```\n<!-- not run: long -->\n```sh\nz\n```\n";
    let found = blocks(page);
    assert_eq!(found.len(), 3);
    assert_eq!(found[0].comment, Some(("file".to_owned(), "a.toml".to_owned())));
    assert_eq!(found[2].comment, Some(("not run".to_owned(), "long".to_owned())));
    let commands = commands(&found[1]);
    assert_eq!(commands.len(), 3);
    assert!(commands[0].keeps_running && !commands[1].keeps_running);
    assert_eq!((commands[1].script.as_str(), commands[1].line), ("zenav goal list", 10));
    assert_eq!((commands[2].exits, commands[1].exits), (7, 0));
    let output = &commands[1].output;
    assert_eq!(*output, ["goal … Succeeded"]);
    assert!(is_in(output, "head\n  goal 7 Succeeded\n").is_ok());
    assert!(is_in(output, "goal 7 Aborted").is_err() && is_in(output, "the goal 7 Succeeded").is_err());
}
