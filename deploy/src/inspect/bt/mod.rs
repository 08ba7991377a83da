//! `zenav bt`. What is a behaviour tree made of, is it valid, what is it doing, and what would it do? Files here, statuses from the mission.

mod nodes;
mod show;
mod simulate;
mod validate;
mod watch;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use zenav_behaviour_tree::{Limits, TreeErrors};
use zenav_mission::trees as missions;

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
    /// Connection and robot.
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
    /// List the nodes that trees may use, with their ports
    Nodes {
        /// Only those whose id or description has this word
        word: Option<String>,
        /// As a TreeNodesModel, which Groot2 loads as its palette
        #[arg(long)]
        xml: bool,
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

fn bad_tree(errors: &TreeErrors) -> Failure {
    Failure::usage(errors.to_string())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
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
