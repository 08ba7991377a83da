//! Are the pages correct? The key table, every link to a file, and the source files that the architecture names.

use crate::workspace::{files, relative, root};

/// Targets of `[text](target)` and `src="target"` outside code, with their lines.
fn links(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let mut in_code = false;
    for (number, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            in_code = !in_code;
            continue;
        }
        if in_code {
            continue;
        }
        // Every second part of a line split at backticks is code.
        let prose: String = line.split('`').step_by(2).collect::<Vec<_>>().join("`");
        for (opening, closing) in [("](", ')'), ("src=\"", '"')] {
            for rest in prose.split(opening).skip(1) {
                let target = rest.split(closing).next().unwrap_or_default();
                found.push((
                    number + 1,
                    target.split_whitespace().next().unwrap_or_default().to_owned(),
                ));
            }
        }
    }
    found
}

/// The anchor of a heading on GitHub and in mdBook.
fn anchor(heading: &str) -> String {
    let kept = heading.to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.collect::<String>().trim().replace(' ', "-")
}

#[test]
fn every_link_to_a_file_or_a_heading_of_the_project_leads_somewhere() {
    for page in files(root(), "md") {
        let text = std::fs::read_to_string(&page).unwrap();
        for (line, target) in links(&text) {
            if target.is_empty() || target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            let (file, heading) = target.split_once('#').unwrap_or((&target, ""));
            let path = if file.is_empty() {
                page.clone()
            } else {
                page.parent().unwrap().join(file)
            };
            let at = format!("{}:{line}: `{target}`", relative(&page));
            assert!(path.exists(), "{at} does not exist");
            if !heading.is_empty() && path.extension().is_some_and(|ending| ending == "md") {
                let text = std::fs::read_to_string(&path).unwrap();
                let headings = text.lines().filter(|line| line.starts_with('#'));
                let known = headings
                    .map(|line| anchor(line.trim_start_matches('#')))
                    .any(|known| known == heading);
                assert!(known, "{at}: no such heading");
            }
        }
    }
}

#[test]
fn every_source_file_that_the_architecture_names_from_the_root_exists() {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let code = page.split('`').skip(1).step_by(2);
    let mut named = 0;
    for path in code.filter(|code| code.ends_with(".rs")) {
        // Other paths are relative to the one before, in prose.
        let is_from_root = |folder: &str| root().join(folder).is_dir();
        if path.split_once('/').is_some_and(|(folder, _)| is_from_root(folder)) {
            assert!(root().join(path).is_file(), "ARCHITECTURE.md: `{path}` does not exist");
            named += 1;
        }
    }
    assert!(named > 30, "the lists of files: {named}");
}

#[test]
fn the_key_table_in_the_docs_is_the_one_in_code() {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let between = page
        .split("<!-- keys: begin -->")
        .nth(1)
        .and_then(|rest| rest.split("<!-- keys: end -->").next())
        .unwrap();
    let table = zenav_protocol::topics::table_markdown();
    assert_eq!(
        between.trim(),
        table.trim(),
        "ARCHITECTURE.md: replace the key table by:\n{table}"
    );
}
