//! Which files belong to a crate without its tests, and which paths do they name? Follows every `mod` from `lib.rs` and `main.rs` that is
//! not `#[cfg(test)]`. Files are read whole: code behind the first test counts too.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use proc_macro2::{Delimiter, Group, TokenStream, TokenTree};

use crate::workspace::{relative, root};

/// A file of production code.
#[derive(Debug)]
pub struct Source {
    /// Path from the workspace root.
    pub path: String,
    /// Every path of at least two segments in it, `use` groups expanded.
    pub names: Vec<Name>,
}

/// A path such as `std::fs::write`; the last segment of a glob is `*`.
#[derive(Clone, Debug)]
pub struct Name {
    pub segments: Vec<String>,
    pub line: usize,
}

impl Name {
    /// Whether it contains these segments in sequence.
    pub fn has(&self, wanted: &[&str]) -> bool {
        self.segments
            .windows(wanted.len())
            .any(|segments| segments.iter().zip(wanted).all(|(is, wanted)| is == wanted))
    }
}

/// The files of a package's library and binary, without its tests.
pub fn sources(folder: &str) -> Vec<Source> {
    let src = root().join(folder).join("src");
    let mut found = Vec::new();
    for entry in ["lib.rs", "main.rs"] {
        let path = src.join(entry);
        if path.is_file() {
            follow(&path, &src, &mut found);
        }
    }
    assert!(!found.is_empty(), "{folder} has no sources");
    found
}

/// Modules of a file that have files of their own, tests included.
pub fn modules_of(path: &str) -> Vec<String> {
    read(&root().join(path), true).modules
}

fn read(path: &Path, with_tests: bool) -> Reader {
    let text = std::fs::read_to_string(path).unwrap();
    let tokens = TokenStream::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut reader = Reader {
        with_tests,
        ..Reader::default()
    };
    reader.stream(tokens);
    if path.ends_with("sim/src/sensors/mod.rs") {
        reader.modules.extend(sensor_kinds());
    }
    reader
}

/// The sensor kinds whose modules a macro declares: the rows of `sensor_kinds!`.
fn sensor_kinds() -> Vec<String> {
    let text = std::fs::read_to_string(root().join("protocol/src/sensors/mod.rs")).unwrap();
    let row = |line: &str| {
        Some(
            line.trim()
                .split_once(": ")
                .filter(|(_, rest)| rest.contains("Model =>"))?
                .0
                .to_owned(),
        )
    };
    let kinds: Vec<String> = text.lines().filter_map(row).collect();
    assert!(!kinds.is_empty(), "no row of `sensor_kinds!` found");
    kinds
}

fn follow(path: &Path, children: &Path, found: &mut Vec<Source>) {
    let reader = read(path, false);
    found.push(Source {
        path: relative(path),
        names: reader.names,
    });
    let mut seen = BTreeSet::new();
    for module in reader.modules {
        let beside: PathBuf = children.join(format!("{module}.rs"));
        let inside = children.join(&module).join("mod.rs");
        let child = if beside.is_file() { beside } else { inside };
        assert!(child.is_file(), "{}: no file for `mod {module}`", path.display());
        if seen.insert(child.clone()) {
            follow(&child, &children.join(&module), found);
        }
    }
}

#[derive(Default)]
struct Reader {
    with_tests: bool,
    names: Vec<Name>,
    modules: Vec<String>,
}

impl Reader {
    fn stream(&mut self, tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let mut at = 0;
        while at < tokens.len() {
            at = self.item(&tokens, at);
        }
    }

    /// Reads the item at a token, and returns the index behind it.
    fn item(&mut self, tokens: &[TokenTree], at: usize) -> usize {
        if !self.with_tests && is_test_attribute(tokens, at) {
            return end_of_item(tokens, at);
        }
        match &tokens[at] {
            TokenTree::Ident(ident) if *ident == "mod" => {
                if let (Some(TokenTree::Ident(name)), Some(TokenTree::Punct(end))) =
                    (tokens.get(at + 1), tokens.get(at + 2))
                    && end.as_char() == ';'
                {
                    self.modules.push(name.to_string());
                }
                at + 1
            }
            TokenTree::Ident(_) => self.path(tokens, at, &[]),
            TokenTree::Group(group) => {
                self.stream(group.stream());
                at + 1
            }
            _ => at + 1,
        }
    }

    /// Reads a path that continues `before`, and returns the index behind it.
    fn path(&mut self, tokens: &[TokenTree], mut at: usize, before: &[String]) -> usize {
        let mut segments = before.to_vec();
        let mut line = 0;
        loop {
            match tokens.get(at) {
                Some(TokenTree::Ident(ident)) => {
                    line = ident.span().start().line;
                    segments.push(ident.to_string());
                    at += 1;
                }
                Some(TokenTree::Punct(star)) if star.as_char() == '*' && !segments.is_empty() => {
                    line = star.span().start().line;
                    segments.push("*".to_owned());
                    at += 1;
                    break;
                }
                Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace && !segments.is_empty() => {
                    self.group(group, &segments);
                    return at + 1;
                }
                _ => break,
            }
            if !is_double_colon(tokens, at) {
                break;
            }
            at += 2;
        }
        if segments.len() > 1 {
            self.names.push(Name { segments, line });
        }
        at
    }

    /// The members of `a::b::{c, d::{e, f}, self}`.
    fn group(&mut self, group: &Group, before: &[String]) {
        let tokens: Vec<TokenTree> = group.stream().into_iter().collect();
        for member in tokens.split(|token| matches!(token, TokenTree::Punct(comma) if comma.as_char() == ',')) {
            if !member.is_empty() {
                self.path(member, 0, before);
            }
        }
    }
}

fn is_double_colon(tokens: &[TokenTree], at: usize) -> bool {
    let colon = |token: Option<&TokenTree>| matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == ':');
    colon(tokens.get(at)) && colon(tokens.get(at + 1))
}

/// `#[cfg(test)]`.
fn is_test_attribute(tokens: &[TokenTree], at: usize) -> bool {
    let (Some(TokenTree::Punct(hash)), Some(TokenTree::Group(attribute))) = (tokens.get(at), tokens.get(at + 1)) else {
        return false;
    };
    hash.as_char() == '#' && attribute.stream().to_string().replace(' ', "") == "cfg(test)"
}

/// Index behind the item of an attribute: behind its braces, or its semicolon.
fn end_of_item(tokens: &[TokenTree], at: usize) -> usize {
    let ends = |token: &TokenTree| match token {
        TokenTree::Punct(punct) => punct.as_char() == ';',
        TokenTree::Group(group) => group.delimiter() == Delimiter::Brace,
        _ => false,
    };
    let rest = tokens.get(at..).unwrap_or_default();
    at + rest.iter().position(ends).map_or(rest.len(), |last| last + 1)
}

#[test]
fn what_stands_behind_a_test_module_is_read_and_the_test_module_is_not() {
    let text = "#[cfg(test)] mod tests; use std::{fs, time::{self, Instant}}; \
                #[cfg(test)] #[allow(x, reason = \"y\")] mod inline { fn f() { std::thread::spawn(g); } } \
                fn late() { tokio::select! { _ = std::net::lookup() => {} } } use a::b::*; mod next;";
    let mut reader = Reader::default();
    reader.stream(TokenStream::from_str(text).unwrap());
    let names: Vec<String> = reader.names.iter().map(|name| name.segments.join("::")).collect();
    let expected = [
        "std::fs",
        "std::time::self",
        "std::time::Instant",
        "tokio::select",
        "std::net::lookup",
        "a::b::*",
    ];
    assert_eq!(names, expected);
    assert_eq!(reader.modules, ["next"]);
}
