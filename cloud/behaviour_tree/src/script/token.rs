//! Tokens. Which words does a script consist of? Names, numbers, text, operators.

use super::ScriptSyntax;

/// Longest script, bytes.
const LENGTH: usize = 8 * 1024;

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Word {
    Name(String),
    Int(i64),
    Double(f64),
    Text(String),
    Operator(&'static str),
}

/// A word and the character where it starts, from 1.
pub(super) type Token = (Word, usize);

/// Longer operators first, so that `<=` is not read as `<` and `=`.
const OPERATORS: [&str; 29] = [
    ":=", "+=", "-=", "*=", "/=", "==", "!=", "<=", ">=", "&&", "||", "..", "=", "<", ">", "+", "-", "*", "/", "!",
    "~", "&", "|", "^", "?", ":", "(", ")", ";",
];

pub(super) fn tokens(text: &str) -> Result<Vec<Token>, ScriptSyntax> {
    if text.len() > LENGTH {
        return Err(wrong(1, "script is too long", &format!("at most {LENGTH} bytes")));
    }
    let chars: Vec<char> = text.chars().collect();
    let mut words = Vec::new();
    let mut at = 0;
    while let Some(first) = chars.get(at).copied() {
        let start = at;
        let word = if first.is_whitespace() {
            at += 1;
            continue;
        } else if first.is_alphabetic() || first == '_' || first == '@' {
            at += 1;
            while chars.get(at).is_some_and(|next| next.is_alphanumeric() || *next == '_') {
                at += 1;
            }
            Word::Name(chars[start..at].iter().collect())
        } else if first.is_ascii_digit() {
            number(&chars, &mut at)?
        } else if first == '\'' {
            at += 1;
            while chars.get(at).is_some_and(|next| *next != '\'') {
                at += 1;
            }
            if at >= chars.len() {
                return Err(wrong(start + 1, "text without an end", "a closing '"));
            }
            at += 1;
            Word::Text(chars[start + 1..at - 1].iter().collect())
        } else {
            let rest: String = chars[at..chars.len().min(at + 2)].iter().collect();
            let Some(operator) = OPERATORS.into_iter().find(|operator| rest.starts_with(operator)) else {
                return Err(wrong(
                    start + 1,
                    &format!("`{first}` means nothing"),
                    "a name, a number, 'text' or an operator",
                ));
            };
            at += operator.len();
            Word::Operator(operator)
        };
        words.push((word, start + 1));
    }
    Ok(words)
}

fn number(chars: &[char], at: &mut usize) -> Result<Word, ScriptSyntax> {
    let start = *at;
    let digits = |at: &mut usize| {
        while chars.get(*at).is_some_and(char::is_ascii_digit) {
            *at += 1;
        }
    };
    if chars[start] == '0' && matches!(chars.get(start + 1), Some('x' | 'X')) {
        *at += 2;
        while chars.get(*at).is_some_and(char::is_ascii_hexdigit) {
            *at += 1;
        }
        let hex: String = chars[start + 2..*at].iter().collect();
        return i64::from_str_radix(&hex, 16)
            .map(Word::Int)
            .map_err(|_| wrong(start + 1, "not a hexadecimal number", "0x and up to 15 digits"));
    }
    digits(at);
    let mut whole = true;
    // `1..2` joins two numbers; it is not `1.` and `.2`.
    if chars.get(*at) == Some(&'.') && chars.get(*at + 1) != Some(&'.') {
        whole = false;
        *at += 1;
        digits(at);
    }
    if matches!(chars.get(*at), Some('e' | 'E')) {
        let sign = usize::from(matches!(chars.get(*at + 1), Some('+' | '-')));
        if chars.get(*at + 1 + sign).is_some_and(char::is_ascii_digit) {
            whole = false;
            *at += 1 + sign;
            digits(at);
        }
    }
    let text: String = chars[start..*at].iter().collect();
    let parsed = if whole {
        text.parse().ok().map(Word::Int)
    } else {
        text.parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
            .map(Word::Double)
    };
    parsed.ok_or_else(|| wrong(start + 1, &format!("`{text}` is out of range"), "a 64-bit number"))
}

pub(super) fn wrong(at: usize, message: &str, expected: &str) -> ScriptSyntax {
    ScriptSyntax {
        at,
        message: message.to_owned(),
        expected: expected.to_owned(),
    }
}
