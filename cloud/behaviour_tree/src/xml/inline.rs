//! Inlining. How is a tree sent whose file includes others? As one text: the lines of the file itself keep their positions, and the
//! included content follows.

use std::collections::BTreeSet;

use super::{Include, Limits};

/// The text of a file with its includes inserted, each file once. Text that is not XML, or has no includes, is returned unchanged: building
/// the tree reports its errors.
///
/// # Errors
/// A message with the including file and the path, when an included file cannot be read, or when the files are too large together.
///
/// ```
/// use zenav_behaviour_tree::inline;
///
/// let main = "<root BTCPP_format=\"4\">\n<include path=\"dock.xml\"/>\n<BehaviorTree ID=\"Main\"><SubTree ID=\"Dock\"/></BehaviorTree></root>";
/// let dock = "<root BTCPP_format=\"4\"><BehaviorTree ID=\"Dock\"><AlwaysSuccess/></BehaviorTree></root>";
/// let whole = inline("main.xml", main, &mut |_: &str, path: &str| Ok((path.to_owned(), dock.into())))?;
/// assert!(whole.contains("<BehaviorTree ID=\"Dock\">") && !whole.contains("<include"));
/// # Ok::<(), String>(())
/// ```
pub fn inline(file: &str, text: &str, include: &mut Include<'_>) -> Result<String, String> {
    let limits = Limits::default();
    let (mut whole, mut included) = (text.to_owned(), String::new());
    let mut known = BTreeSet::from([file.to_owned()]);
    let mut todo = vec![(file.to_owned(), text.to_owned())];
    let mut size = text.len();
    while let Some((name, text)) = todo.pop() {
        let Ok(document) = roxmltree::Document::parse(&text) else {
            if name == file {
                return Ok(whole);
            }
            return Err(format!("{name}: expected well-formed XML"));
        };
        for part in document.root_element().children().filter(roxmltree::Node::is_element) {
            let path = part.attribute("path").filter(|_| part.has_tag_name("include"));
            let Some(path) = path else {
                if name != file {
                    included.push_str(text.get(part.range()).unwrap_or_default());
                    included.push('\n');
                }
                continue;
            };
            let (found, bytes) = include(&name, path).map_err(|why| format!("{name}: include `{path}`: {why}"))?;
            size += bytes.len();
            if size > limits.bytes || known.len() > limits.includes {
                return Err(format!(
                    "{name}: expected at most {} included files and {} bytes in all",
                    limits.includes, limits.bytes
                ));
            }
            if known.insert(found.clone()) {
                let text = String::from_utf8(bytes).map_err(|_| format!("{found}: expected text in UTF-8"))?;
                todo.push((found, text.trim_start_matches('\u{feff}').to_owned()));
            }
        }
        if name == file {
            let includes = document
                .root_element()
                .children()
                .filter(|part| part.has_tag_name("include"));
            for part in includes.filter(|part| part.has_attribute("path")) {
                let blank = part.range();
                let lines = text.get(blank.clone()).unwrap_or_default();
                let lines: String = lines.chars().map(|c| if c == '\n' { '\n' } else { ' ' }).collect();
                // The same number of bytes as before, so that nothing after it moves.
                let lines = format!("{lines}{}", " ".repeat(blank.len().saturating_sub(lines.len())));
                whole.replace_range(blank, &lines);
            }
        }
    }
    if let (false, Some(end)) = (included.is_empty(), whole.rfind("</")) {
        whole.insert_str(end, &included);
        if let Some((at, id)) = only_tree(text) {
            whole.insert_str(at, &format!(" main_tree_to_execute=\"{id}\""));
        }
    }
    Ok(whole)
}

/// The id of a file's only tree, which is the main one unless stated otherwise, and the position in the root's tag where to state it.
fn only_tree(text: &str) -> Option<(usize, String)> {
    let document = roxmltree::Document::parse(text).ok()?;
    let root = document.root_element();
    let mut trees = root.children().filter(|part| part.has_tag_name("BehaviorTree"));
    let id = trees.next()?.attribute_node("ID")?;
    let named = root.has_attribute("main_tree_to_execute") || trees.next().is_some();
    let at = root.range().start + "<".len() + root.tag_name().name().len();
    (!named).then_some((at, text.get(id.range_value())?.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(from: &str, path: &str) -> Result<(String, Vec<u8>), String> {
        let text = match path {
            "a.xml" => "<root><include path='b.xml'/><BehaviorTree ID='A'><SubTree ID='B'/></BehaviorTree></root>",
            "b.xml" => "<root><include path='a.xml'/>\n<BehaviorTree ID='B'><AlwaysSuccess/></BehaviorTree></root>",
            _ => return Err(format!("no such file beside {from}")),
        };
        Ok((path.to_owned(), text.as_bytes().to_vec()))
    }

    #[test]
    fn what_is_included_follows_once_and_lines_stay() {
        let main = "<root BTCPP_format=\"4\">\n<include\n path=\"a.xml\"/>\n<BehaviorTree ID=\"M\"><SubTree ID=\"A\"/></BehaviorTree>\n</root>\n";
        let whole = inline("m.xml", main, &mut files).unwrap();
        assert!(!whole.contains("include"), "{whole}");
        for id in ["'A'><", "'B'><"] {
            assert_eq!(whole.matches(&format!("<BehaviorTree ID={id}")).count(), 1, "{whole}");
        }
        assert_eq!(whole.lines().nth(3), main.lines().nth(3));
        assert!(roxmltree::Document::parse(&whole).is_ok());
    }

    #[test]
    fn a_missing_file_is_named_and_what_is_no_xml_stays() {
        let main = "<root><include path='c.xml'/></root>";
        let error = inline("m.xml", main, &mut files).unwrap_err();
        assert!(error.contains("m.xml: include `c.xml`: no such file"), "{error}");
        assert_eq!(inline("m.xml", "<root><", &mut files).unwrap(), "<root><");
    }
}
