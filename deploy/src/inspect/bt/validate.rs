//! `zenav bt validate`. Checks whether a mission would accept a tree; reports all errors of a file at once.

use std::collections::BTreeMap;

use serde::Serialize;
use zenav_behaviour_tree::{self as trees, Limits, Summary, TreeError, TreeErrors};
use zenav_mission::trees as missions;

use super::{Source, includer};
use crate::exit_code;
use crate::failure::Outcome;
use crate::output::{self, Format};

#[derive(Debug, Serialize)]
struct Validated {
    file: String,
    valid: bool,
    /// Nodes of each tree, SubTrees expanded.
    trees: BTreeMap<String, u64>,
    /// Why a mission may refuse the tree.
    warnings: Vec<String>,
    errors: Vec<TreeError>,
    /// Number of errors not listed.
    more: usize,
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
            Err(TreeErrors { errors, more }) => Self {
                file,
                valid: false,
                trees: BTreeMap::new(),
                warnings: Vec::new(),
                errors,
                more,
            },
        }
    }

    fn text(&self) -> String {
        if self.valid {
            let tree = |(id, nodes): (&String, &u64)| format!("{id} ({})", output::counted(*nodes, "node"));
            let trees = match self.trees.is_empty() {
                true => "no tree in it".to_owned(),
                false => output::listed(self.trees.iter().map(tree)),
            };
            let warnings: String = self.warnings.iter().map(|w| format!("\nwarning: {w}")).collect();
            return format!("{}: valid: {trees}{warnings}", self.file);
        }
        let mut lines: Vec<String> = self.errors.iter().map(TreeError::to_string).collect();
        if self.more > 0 {
            lines.push(format!("and {} more", self.more));
        }
        lines.join("\n")
    }
}

pub(super) fn validate(file: &str, format: Format) -> Outcome {
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

#[cfg(test)]
mod tests {
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
            "t.xml: valid: T (1 node)\nwarning: t.xml:2:34: nothing here implements `SaySomething`: a mission would refuse it"
        );
    }

    #[test]
    fn a_port_without_which_a_node_fails_is_missed_before_the_tree_runs() {
        let tree = |leaf: &str| format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"T\">{leaf}</BehaviorTree></root>");
        let report = check(&tree("<FollowPath/>"));
        assert!(!report.valid && report.errors.len() == 1);
        assert!(
            report.text().contains("`FollowPath` without port `path`"),
            "{}",
            report.text()
        );
        assert!(check(&tree("<FollowPath path=\"{path}\"/>")).valid);
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
}
