//! `zenav bt`. Behaviour trees: validate, draw and simulate files, list nodes, and watch the tree of a running mission.

mod nodes;
mod show;
mod simulate;
mod validate;
mod watch;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use zenav_behaviour_tree::{Limits, TreeErrors};
use zenav_mission::trees as missions;

use crate::completion;
use crate::connect::RobotArgs;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::Format;

/// Behaviour trees.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav bt validate patrol.xml\n  zenav bt show navigate\n  zenav bt watch\n  zenav bt nodes --xml > nodes.xml    Groot2's palette"
)]
pub struct BtArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: BtCommand,
}

#[derive(Debug, clap::Subcommand)]
enum BtCommand {
    /// Check a tree file against the nodes that missions know; reports all errors at once
    Validate {
        /// Tree file, or name of a shipped tree
        #[arg(add = completion::behaviour_trees())]
        file: String,
    },
    /// Draw a tree, with the ports of its nodes
    Show {
        /// Tree file, or name of a shipped tree
        #[arg(add = completion::behaviour_trees())]
        file: String,
        /// Tree of the file to draw [default: the main one]
        #[arg(long, value_name = "ID")]
        tree: Option<String>,
        /// Write a picture instead of drawing in the terminal: SVG or PNG, by the file's extension
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// List the nodes that trees may use, with their ports
    Nodes {
        /// Only nodes whose id or description contains this word
        word: Option<String>,
        /// Print a TreeNodesModel, which Groot2 loads as its palette
        #[arg(long)]
        xml: bool,
    },
    /// Draw the tree that a mission runs, with the status of every node, and after its end with the results, until Ctrl-C
    Watch {
        /// Draw it once and exit
        #[arg(long)]
        once: bool,
    },
    /// Run a tree against a script in simulated time; the tree's result is in `status`, the exit code is 0 either way
    Simulate {
        /// Tree file, or name of a shipped tree
        #[arg(add = completion::behaviour_trees())]
        file: String,
        /// Script of the leaves' results, JSON [default: all succeed]
        #[arg(long, value_name = "FILE")]
        script: Option<PathBuf>,
        /// Tree of the file to run [default: the main one]
        #[arg(long, value_name = "ID")]
        tree: Option<String>,
    },
}

/// Validates, draws, watches and simulates trees.
///
/// # Errors
/// `exit_code::NOT_FOUND` for a missing file, `exit_code::USAGE` for a bad one.
pub fn bt(args: &BtArgs) -> Outcome {
    match &args.command {
        BtCommand::Validate { file } => validate::validate(file, args.output),
        BtCommand::Show { file, tree, out } => show::show(file, tree.as_deref(), out.as_deref(), args.output),
        BtCommand::Nodes { word, xml } => nodes::nodes(word.as_deref(), *xml, args.output),
        BtCommand::Watch { once } => watch::watch(&args.robot, *once, args.output),
        BtCommand::Simulate { file, script, tree } => {
            simulate::simulate(file, script.as_deref(), tree.as_deref(), args.output)
        }
    }
}

/// The text of a tree, and its name in messages.
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
        let text = missions::shipped(file).ok_or_else(|| files::unknown("tree", file, "", missions::SHIPPED))?;
        Ok(Self {
            name: format!("{file}.xml"),
            text: text.as_bytes().to_vec(),
        })
    }
}

/// Finds included files beside the including file, or among the shipped ones. A file keeps the name under which it was first found, `main`
/// the name it was requested by; differently spelled paths to one file are the same file.
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

fn bad_tree(errors: &TreeErrors) -> Failure {
    Failure::usage(errors.to_string())
}

#[cfg(test)]
mod tests {
    use crate::exit_code;

    use super::*;

    #[test]
    fn a_missing_tree_is_answered_with_the_known_ones() {
        let failure = Source::read("nope").map(|_| ()).unwrap_err();
        assert_eq!(failure.code, exit_code::NOT_FOUND);
        assert!(failure.message.contains("kitchen"), "{failure}");
    }
}
