//! What is a behaviour tree made of, is it valid, what is it doing, and what would it do? Files here, statuses from the mission.

use std::collections::BTreeMap;
use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;
use zenav_behaviour_tree::{self as trees, Limits, Summary, TreeErrors, simulate};
use zenav_mission::trees as missions;
use zenav_protocol::messages::{MissionStatus, NodeStatus, exit_code};
use zenav_protocol::topics;

use super::{diagnosis, tree_picture};
use crate::connect::{self, RobotArgs};
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{self, Format};

/// Behaviour trees.
#[derive(Debug, clap::Args)]
pub struct BtArgs {
    /// Which robot.
    #[command(flatten)]
    robot: RobotArgs,
    /// Form of what is printed
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: BtCommand,
}

#[derive(Debug, clap::Subcommand)]
enum BtCommand {
    /// Check a tree file against the nodes that missions know; all errors at once
    Validate {
        /// Tree file, or the name of a shipped one
        file: String,
    },
    /// Draw a tree
    Show {
        /// Tree file, or the name of a shipped one
        file: String,
        /// Which tree of the file [default: the main one]
        #[arg(long, value_name = "ID")]
        tree: Option<String>,
        /// Write a picture, SVG or PNG by the name's ending, not to the terminal
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Draw the tree that a mission runs, with the status of every node, until Ctrl-C
    Watch {
        /// Draw it once
        #[arg(long)]
        once: bool,
    },
    /// Play a script to a tree in simulated time; exit 0 whatever the tree answers, which is in `status`
    Simulate {
        /// Tree file, or the name of a shipped one
        file: String,
        /// How its leaves answer, JSON [default: all succeed]
        #[arg(long, value_name = "FILE")]
        script: Option<PathBuf>,
        /// Which tree of the file [default: the main one]
        #[arg(long, value_name = "ID")]
        tree: Option<String>,
    },
}

/// Validates, draws, watches and simulates trees.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for a missing file, [`exit_code::USAGE`] for a bad one.
pub fn bt(args: &BtArgs) -> Outcome {
    match &args.command {
        BtCommand::Validate { file } => validate(file, args.output),
        BtCommand::Show { file, tree, out } => show(file, tree.as_deref(), out.as_deref(), args.output),
        BtCommand::Watch { once } => watch(&args.robot, *once, args.output),
        BtCommand::Simulate { file, script, tree } => simulate(file, script.as_deref(), tree.as_deref(), args.output),
    }
}

/// A tree's text and the name for messages.
struct Source {
    name: String,
    text: Vec<u8>,
}

impl Source {
    fn read(file: &str) -> Result<Self, Failure> {
        let path = Path::new(file);
        if path.is_file() {
            let limit = Limits::default().bytes as u64;
            let size = path.metadata()?.len();
            if size > limit {
                return Err(Failure::usage(format!(
                    "{file}: {size} bytes: expected at most {limit}"
                )));
            }
            return Ok(Self {
                name: file.to_owned(),
                text: std::fs::read(path)?,
            });
        }
        match missions::shipped(file) {
            Some(text) => Ok(Self {
                name: format!("{file}.xml"),
                text: text.as_bytes().to_vec(),
            }),
            None => {
                let names: Vec<&str> = missions::SHIPPED.iter().map(|(name, _)| *name).collect();
                Err(Failure::not_found(format!(
                    "no tree `{file}`: expected a file or one of {}",
                    names.join(", ")
                )))
            }
        }
    }
}

/// Finds included files beside the including one, or among the shipped. A file keeps the name by which it was found
/// first, `main` the one that it was asked for by: however a path is written, it is the same file.
pub(crate) fn includer(main: &str) -> impl FnMut(&str, &str) -> Result<(String, Vec<u8>), String> + use<> {
    let mut names: BTreeMap<PathBuf, String> = BTreeMap::new();
    if let Ok(file) = Path::new(main).canonicalize() {
        names.insert(file, main.to_owned());
    }
    move |from, path| {
        let file = Path::new(from).parent().unwrap_or_else(|| Path::new("")).join(path);
        if let (false, Some(text)) = (file.is_file(), path.strip_suffix(".xml").and_then(missions::shipped)) {
            return Ok((path.to_owned(), text.as_bytes().to_vec()));
        }
        let limit = Limits::default().bytes as u64;
        let text = files::text_within(&file, limit).map_err(|failure| failure.to_string())?;
        let name = file.display().to_string();
        let name = match file.canonicalize() {
            Ok(file) => names.entry(file).or_insert(name).clone(),
            Err(_) => name,
        };
        Ok((name, text.into_bytes()))
    }
}

#[derive(Debug, Serialize)]
struct Validated {
    file: String,
    valid: bool,
    /// Nodes of each tree, SubTrees unfolded.
    trees: BTreeMap<String, u64>,
    /// What a mission may refuse.
    warnings: Vec<String>,
    errors: Vec<Mistake>,
    /// Errors beyond those.
    more: usize,
}

#[derive(Debug, Serialize)]
struct Mistake {
    file: String,
    line: u32,
    column: u32,
    message: String,
    expected: String,
}

impl Validated {
    fn new(file: String, checked: Result<Summary, TreeErrors>) -> Self {
        match checked {
            Ok(Summary { trees, warnings }) => Self {
                file,
                valid: true,
                trees,
                warnings,
                errors: Vec::new(),
                more: 0,
            },
            Err(TreeErrors { errors, more }) => {
                let mistake = |error: trees::TreeError| Mistake {
                    file: error.file,
                    line: error.line,
                    column: error.column,
                    message: error.message,
                    expected: error.expected,
                };
                Self {
                    file,
                    valid: false,
                    trees: BTreeMap::new(),
                    warnings: Vec::new(),
                    errors: errors.into_iter().map(mistake).collect(),
                    more,
                }
            }
        }
    }

    fn text(&self) -> String {
        if self.valid {
            let trees: Vec<String> = self
                .trees
                .iter()
                .map(|(id, nodes)| format!("{id} ({nodes} nodes)"))
                .collect();
            let trees = if trees.is_empty() {
                "no tree in it".to_owned()
            } else {
                trees.join(", ")
            };
            let warnings: String = self.warnings.iter().map(|w| format!("\nwarning: {w}")).collect();
            return format!("{}: valid: {trees}{warnings}", self.file);
        }
        let mut lines: Vec<String> = self
            .errors
            .iter()
            .map(|e| {
                format!(
                    "{}:{}:{}: {}: expected {}",
                    e.file, e.line, e.column, e.message, e.expected
                )
            })
            .collect();
        if self.more > 0 {
            lines.push(format!("and {} more", self.more));
        }
        lines.join("\n")
    }
}

fn validate(file: &str, format: Format) -> Outcome {
    let source = Source::read(file)?;
    let checked = trees::check(
        &source.name,
        &source.text,
        missions::registry(),
        &mut includer(&source.name),
        Limits::default(),
    );
    let report = Validated::new(source.name, checked);
    output::value(format, &report, Validated::text)?;
    Ok(if report.valid { exit_code::OK } else { exit_code::USAGE })
}

fn bad_tree(errors: &TreeErrors) -> Failure {
    Failure::usage(errors.to_string())
}

/// Drawn over the simulation's nodes: a tree for another robot can be looked at too.
fn show(file: &str, id: Option<&str>, out: Option<&Path>, format: Format) -> Outcome {
    let source = Source::read(file)?;
    let mut include = includer(&source.name);
    let tree = trees::build(&source.name, &source.text, &simulate::registry(), id, &mut include)
        .map_err(|errors| bad_tree(&errors))?;
    let Some(out) = out else {
        output::value(format, &tree.report(), |_| tree.render())?;
        return Ok(exit_code::OK);
    };
    let ending = out
        .extension()
        .and_then(|ending| ending.to_str())
        .map(str::to_ascii_lowercase);
    let picture = match ending.as_deref() {
        Some("svg") => tree_picture::svg(&tree.report()).into_bytes(),
        Some("png") => tree_picture::png(&tree.report())?,
        _ => {
            return Err(Failure::usage(format!(
                "--out {}: expected a name that ends with .svg or .png",
                out.display()
            )));
        }
    };
    std::fs::write(out, picture).map_err(|error| Failure::usage(format!("{}: {error}", out.display())))?;
    Ok(exit_code::OK)
}

fn simulate(file: &str, script: Option<&Path>, id: Option<&str>, format: Format) -> Outcome {
    let script: simulate::Script = match script {
        Some(path) => serde_json::from_str(&files::text(path)?)
            .map_err(|error| Failure::usage(format!("{}: {error}", path.display())))?,
        None => simulate::Script::default(),
    };
    let source = Source::read(file)?;
    let mut include = includer(&source.name);
    let outcome = simulate::simulate(&source.name, &source.text, id, &script, &mut include)
        .map_err(|errors| bad_tree(&errors))?;
    for warning in &outcome.warnings {
        tracing::warn!("{warning}");
    }
    output::value(format, &outcome, |outcome| {
        let rows: Vec<Vec<String>> = outcome
            .counts
            .iter()
            .map(|(leaf, starts)| vec![leaf.clone(), starts.to_string()])
            .collect();
        let error = outcome
            .error
            .as_ref()
            .map(|error| format!(": {error}"))
            .unwrap_or_default();
        let late = if outcome.timed_out { ", time ran out" } else { "" };
        format!(
            "{}{error} after {} ticks, {} ms{late}\n\n{}",
            outcome.status,
            outcome.ticks,
            outcome.sim_time_ms,
            output::table(&["LEAF", "STARTS"], &rows)
        )
    })?;
    Ok(if outcome.error.is_some() {
        exit_code::FAILED
    } else {
        exit_code::OK
    })
}

fn watch(robot: &RobotArgs, once: bool, format: Format) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let mut missions = bus.latest(&topics::MISSION, &[&robot])?;
        let live = std::io::stdout().is_terminal() && format == Format::Table && !once;
        let mut drawn = 0;
        let mut last = String::new();
        loop {
            let patience = if last.is_empty() { patience } else { Duration::MAX };
            let received = tokio::select! {
                biased;
                _ = tokio::signal::ctrl_c() => return Ok(exit_code::INTERRUPTED),
                received = tokio::time::timeout(patience, missions.next()) => received,
            };
            let status = match received {
                Ok(Some(received)) => received.message,
                Ok(None) => return Err(Failure::new(exit_code::CANNOT_CONNECT, "the bus was closed")),
                Err(_) => {
                    return Err(Failure::new(
                        exit_code::TIMEOUT,
                        format!(
                            "no word from {} in time: does a mission run?",
                            topics::MISSION.key(&[&robot])
                        ),
                    ));
                }
            };
            let text = picture(&status, live);
            if text == last && format == Format::Table {
                continue;
            }
            if live {
                // Over what was drawn before.
                let up = if drawn > 0 {
                    format!("\x1b[{drawn}A\x1b[J")
                } else {
                    String::new()
                };
                output::line(&format!("{up}{text}"));
                drawn = text.lines().count();
            } else {
                output::value(format, &status, |_| text.clone())?;
            }
            last = text;
            if once {
                return Ok(exit_code::OK);
            }
        }
    })
}

/// A mission's tree, a node a row.
fn picture(status: &MissionStatus, colors: bool) -> String {
    let goal = status.goal_id.as_deref().unwrap_or("no goal");
    let leads = match status.leads {
        true => format!("leads, {}", diagnosis::standbys(status)),
        false => "does not lead".to_owned(),
    };
    let mut lines = vec![format!(
        "{} {leads} (epoch {}): {goal}, tree {}, {} waiting",
        status.holder,
        status.epoch,
        status.tree.as_deref().unwrap_or("none"),
        status.queued
    )];
    let mut depths = BTreeMap::new();
    for node in &status.nodes {
        // Document order: a parent comes before its children.
        let depth = node
            .parent
            .and_then(|parent| depths.get(&parent))
            .map_or(0, |depth: &usize| depth + 1);
        depths.insert(node.uid, depth);
        lines.push(row(node, depth, colors));
    }
    lines.join("\n")
}

fn row(node: &NodeStatus, depth: usize, colors: bool) -> String {
    let mark = match node.status.as_str() {
        "RUNNING" => ('▶', 33),
        "SUCCESS" => ('✓', 32),
        "FAILURE" => ('✗', 31),
        "SKIPPED" => ('-', 90),
        _ => ('·', 90),
    };
    let id = if node.id == node.name {
        String::new()
    } else {
        format!(" [{}]", node.id)
    };
    let feedback = if node.feedback.is_empty() {
        String::new()
    } else {
        format!("  {}", node.feedback)
    };
    // A feedback of several lines, or with the terminal's own codes, must not break the picture.
    let text: String = format!("{}{id}{feedback}", node.name)
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    let indent = "  ".repeat(depth.min(40));
    if colors {
        format!("{indent}\x1b[{}m{}\x1b[0m {text}", mark.1, mark.0)
    } else {
        format!("{indent}{} {text}", mark.0)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
mod tests {
    use zenav_protocol::messages::GoalFeedback;
    use zenav_protocol::time::Stamp;

    use super::*;

    fn check(text: &str) -> Validated {
        let checked = trees::check(
            "t.xml",
            text.as_bytes(),
            missions::registry(),
            &mut includer("t.xml"),
            Limits::default(),
        );
        Validated::new("t.xml".into(), checked)
    }

    #[test]
    fn a_file_is_the_same_however_its_path_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let main = folder.path().join("main.xml");
        std::os::unix::fs::symlink(folder.path(), folder.path().join("link")).unwrap();
        let text = r#"<root BTCPP_format="4"><include path="././main.xml"/><include path="link/main.xml"/>
            <BehaviorTree ID="M"><AlwaysSuccess/></BehaviorTree></root>"#;
        std::fs::write(&main, text).unwrap();
        let name = main.display().to_string();
        let checked = trees::check(
            &name,
            text.as_bytes(),
            missions::registry(),
            &mut includer(&name),
            Limits::default(),
        );
        let report = Validated::new(name.clone(), checked);
        let expected = format!("warning: {name}:1:33: files include one another: {name} > {name}: each is read once");
        assert_eq!(
            report.text().lines().nth(1),
            Some(expected.as_str()),
            "{}",
            report.text()
        );
        assert_eq!(report.warnings.len(), 1);
    }

    #[test]
    fn what_only_the_file_describes_is_valid_with_a_warning() {
        let report = check(
            r#"<root BTCPP_format="4"><TreeNodesModel><Action ID="SaySomething"/></TreeNodesModel>
            <BehaviorTree ID="T"><SaySomething/></BehaviorTree></root>"#,
        );
        assert_eq!(
            report.text(),
            "t.xml: valid: T (1 nodes)\nwarning: t.xml:2:34: nothing here implements `SaySomething`: a mission would refuse it"
        );
    }

    #[test]
    fn every_shipped_tree_is_valid() {
        for (name, _) in missions::SHIPPED {
            assert_eq!(validate(name, Format::Json).unwrap(), exit_code::OK, "{name}");
        }
    }

    #[test]
    fn mistakes_are_told_with_their_place_all_at_once() {
        let report = check(
            "<root BTCPP_format=\"4\">\n  <BehaviorTree ID=\"T\">\n    <Sequence>\n      <Fly/>\n      <Wait wait_duration=\"long\"/>\n    </Sequence>\n  </BehaviorTree>\n</root>",
        );
        assert!(!report.valid);
        assert_eq!(
            report.errors.iter().map(|error| error.line).collect::<Vec<_>>(),
            [4, 5],
            "{}",
            report.text()
        );
        assert!(report.text().contains("Fly"));
    }

    #[test]
    fn a_missing_tree_is_answered_with_the_known_ones() {
        let failure = validate("nope", Format::Json).unwrap_err();
        assert_eq!(failure.code, exit_code::NOT_FOUND);
        assert!(failure.message.contains("kitchen"), "{failure}");
    }

    #[test]
    fn a_mission_is_drawn_by_depth() {
        let node = |uid, parent, name: &str, status: &str| NodeStatus {
            uid,
            parent,
            name: name.into(),
            id: name.into(),
            status: status.into(),
            feedback: String::new(),
        };
        let status = MissionStatus {
            stamp: Stamp(0),
            holder: "m".into(),
            leads: true,
            epoch: 2,
            goal_id: None,
            tree: Some("T".into()),
            nodes: vec![
                node(1, None, "Sequence", "RUNNING"),
                node(2, Some(1), "Wait", "SUCCESS"),
                node(3, Some(1), "Drive\n", "RUNNING"),
            ],
            feedback: GoalFeedback::default(),
            queued: 0,
            standbys: Vec::new(),
        };
        let drawn = picture(&status, false);
        assert_eq!(
            drawn.lines().skip(1).collect::<Vec<_>>(),
            ["▶ Sequence", "  ✓ Wait", "  ▶ Drive "]
        );
    }
}
