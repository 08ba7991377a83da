//! Guard. Is this text safe for the XML parser? One pass over the bytes refuses constructs that cost a parser more than linear time or
//! memory: document types and entities, namespaces, great depth, and very many attributes. Text that is not XML at all is left to the
//! parser.

/// Most attributes of one element: the parser compares them pairwise.
const ATTRIBUTES: usize = 256;

/// The refused construct and its byte position.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Refused {
    pub(super) at: usize,
    pub(super) message: String,
    pub(super) expected: String,
}

/// Scans a text. `depth` is the greatest number of element levels.
pub(super) fn guard(text: &str, depth: usize) -> Result<(), Refused> {
    let refuse = |at, message: &str, expected: String| {
        Err(Refused {
            at,
            message: message.to_owned(),
            expected,
        })
    };
    let bytes = text.as_bytes();
    let mut at = 0;
    let mut level = 0_usize;
    while let Some(found) = find(bytes, at, b"<") {
        let rest = &bytes[found..];
        let end = if rest.starts_with(b"<!--") {
            find(bytes, found + 4, b"-->").map(|end| end + 3)
        } else if rest.starts_with(b"<![CDATA[") {
            find(bytes, found + 9, b"]]>").map(|end| end + 3)
        } else if rest.starts_with(b"<?") {
            find(bytes, found + 2, b"?>").map(|end| end + 2)
        } else if rest.starts_with(b"<!") {
            let expected = "no document type: neither entities nor DTDs".to_owned();
            return refuse(found, "document type declaration", expected);
        } else if rest.starts_with(b"</") {
            level = level.saturating_sub(1);
            find(bytes, found + 2, b">").map(|end| end + 1)
        } else {
            let tag = tag(bytes, found + 1);
            if tag.attributes > ATTRIBUTES {
                let expected = format!("at most {ATTRIBUTES}");
                return refuse(found, "element with too many attributes", expected);
            }
            if let Some(namespace) = tag.namespace {
                return refuse(namespace, "XML namespace", "names without a namespace".to_owned());
            }
            level += usize::from(!tag.closes_itself);
            if level > depth {
                return refuse(
                    found,
                    "elements are nested too deeply",
                    format!("at most {depth} levels"),
                );
            }
            tag.end
        };
        // An unfinished construct: the parser reports it.
        let Some(end) = end else { return Ok(()) };
        at = end;
    }
    Ok(())
}

#[derive(Default)]
struct Tag {
    attributes: usize,
    namespace: Option<usize>,
    closes_itself: bool,
    end: Option<usize>,
}

/// Scans to the end of a start tag, skipping quoted values.
fn tag(bytes: &[u8], mut at: usize) -> Tag {
    let mut tag = Tag::default();
    while let Some(byte) = bytes.get(at) {
        match byte {
            b'"' | b'\'' => match find(bytes, at + 1, &[*byte]) {
                Some(close) => at = close,
                None => return tag,
            },
            b'=' => tag.attributes += 1,
            b'x' if tag.namespace.is_none() && bytes[at..].starts_with(b"xmlns") => {
                let starts = bytes.get(at.wrapping_sub(1)).is_some_and(u8::is_ascii_whitespace);
                tag.namespace = starts.then_some(at);
            }
            b'>' => {
                tag.closes_itself = bytes.get(at.wrapping_sub(1)) == Some(&b'/');
                tag.end = Some(at + 1);
                return tag;
            }
            _ => {}
        }
        at += 1;
    }
    tag
}

fn find(bytes: &[u8], from: usize, what: &[u8]) -> Option<usize> {
    let rest = bytes.get(from..)?;
    match what {
        [only] => rest.iter().position(|byte| byte == only).map(|found| from + found),
        _ => rest
            .windows(what.len())
            .position(|window| window == what)
            .map(|found| from + found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_is_counted_outside_of_comments_and_quotes() {
        let text = "<?xml version='1.0'?><a><!-- <b><b><b> --><b x='<c>'/><b/><![CDATA[<<<]]></a>";
        assert_eq!(guard(text, 1), Ok(()));
        assert_eq!(guard("<a><b><c/></b></a>", 1).unwrap_err().at, 3);
        assert!(guard(&"<a>".repeat(10_000), 256).is_err());
    }

    #[test]
    fn entities_namespaces_and_crowds_of_attributes_are_refused() {
        let bomb = "<!DOCTYPE a [<!ENTITY b 'b'>]><a>&b;</a>";
        assert!(guard(bomb, 256).unwrap_err().message.contains("document type"));
        assert!(
            guard("<a xmlns:b='c'/>", 256)
                .unwrap_err()
                .message
                .contains("namespace")
        );
        let crowd: String = (0..300).map(|index| format!(" a{index}=''")).collect();
        assert!(
            guard(&format!("<a{crowd}/>"), 256)
                .unwrap_err()
                .message
                .contains("attributes")
        );
    }

    #[test]
    fn what_is_unfinished_is_left_to_the_parser() {
        for text in ["<", "<a", "<a b='", "<!-- ", "<![CDATA[", "<?x", "</", ""] {
            assert_eq!(guard(text, 1), Ok(()), "{text}");
        }
    }
}
