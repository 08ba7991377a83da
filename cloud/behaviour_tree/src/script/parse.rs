//! Parser. In which order is a script evaluated? Precedence from weakest to strongest, as in BehaviorTree.CPP: assignment, `?:`, `||`,
//! `&&`, comparison, `| ^`, `&`, `..`, `+ -`, `* /`, prefixes.

use super::token::{Token, Word, tokens, wrong};
use super::{Assignment, Binary, Comparison, Expression, ScriptSyntax, Unary};
use crate::value::Value;

/// Deepest nesting of brackets and prefixes.
const NESTING: usize = 32;
/// Most words in a script: a chain of operators gives a tree as deep as the chain is long.
const WORDS: usize = 500;

type Parsed = Result<Expression<String>, ScriptSyntax>;

/// Parses a script into its statements, at least one.
pub(crate) fn parse(text: &str) -> Result<Vec<Expression<String>>, ScriptSyntax> {
    let words = tokens(text)?;
    if let Some((_, at)) = words.get(WORDS) {
        return Err(wrong(*at, "script is too long", &format!("at most {WORDS} words")));
    }
    let mut parser = Parser {
        words,
        next: 0,
        end: text.chars().count() + 1,
        nesting: 0,
    };
    let mut statements = Vec::new();
    loop {
        while parser.take(&[";"]).is_some() {}
        if parser.next == parser.words.len() {
            break;
        }
        statements.push(parser.assignment()?);
        if parser.next < parser.words.len() && parser.peek(&[";"]).is_none() {
            return Err(parser.unexpected("an operator or ;"));
        }
    }
    if statements.is_empty() {
        return Err(wrong(1, "script is empty", "at least one statement"));
    }
    Ok(statements)
}

struct Parser {
    words: Vec<Token>,
    next: usize,
    end: usize,
    nesting: usize,
}

impl Parser {
    fn peek(&self, operators: &[&'static str]) -> Option<&'static str> {
        match self.words.get(self.next) {
            Some((Word::Operator(operator), _)) if operators.contains(operator) => Some(operator),
            _ => None,
        }
    }

    fn take(&mut self, operators: &[&'static str]) -> Option<&'static str> {
        let found = self.peek(operators)?;
        self.next += 1;
        Some(found)
    }

    fn unexpected(&self, expected: &str) -> ScriptSyntax {
        match self.words.get(self.next) {
            None => wrong(self.end, "script ends too early", expected),
            Some((word, at)) => {
                let found = match word {
                    Word::Name(name) => name.clone(),
                    Word::Int(value) => value.to_string(),
                    Word::Double(value) => value.to_string(),
                    Word::Text(text) => format!("'{text}'"),
                    Word::Operator(operator) => (*operator).to_owned(),
                };
                wrong(*at, &format!("`{found}` does not fit"), expected)
            }
        }
    }

    fn nested(&mut self, inner: impl FnOnce(&mut Self) -> Parsed) -> Parsed {
        if self.nesting >= NESTING {
            return Err(self.unexpected(&format!("at most {NESTING} levels of nesting")));
        }
        self.nesting += 1;
        let parsed = inner(self);
        self.nesting -= 1;
        parsed
    }

    fn assignment(&mut self) -> Parsed {
        let target = self.ternary()?;
        let operator = match self.peek(&[":=", "=", "+=", "-=", "*=", "/="]) {
            None => return Ok(target),
            Some(":=") => Assignment::Create,
            Some("=") => Assignment::Existing,
            Some("+=") => Assignment::Update(Binary::Add),
            Some("-=") => Assignment::Update(Binary::Subtract),
            Some("*=") => Assignment::Update(Binary::Multiply),
            Some(_) => Assignment::Update(Binary::Divide),
        };
        let Expression::Variable(to) = target else {
            return Err(self.unexpected("a name on the left of an assignment"));
        };
        self.next += 1;
        let value = Box::new(self.nested(Self::assignment)?);
        Ok(Expression::Assign { to, operator, value })
    }

    fn ternary(&mut self) -> Parsed {
        let condition = self.or()?;
        if self.take(&["?"]).is_none() {
            return Ok(condition);
        }
        let yes = self.nested(Self::assignment)?;
        if self.take(&[":"]).is_none() {
            return Err(self.unexpected("the : of ?:"));
        }
        let no = self.nested(Self::assignment)?;
        Ok(Expression::Ternary(Box::new([condition, yes, no])))
    }

    fn chain(&mut self, operators: &[(&'static str, Binary)], inner: fn(&mut Self) -> Parsed) -> Parsed {
        let mut left = inner(self)?;
        while let Some((_, operator)) = operators.iter().find(|(text, _)| self.peek(&[*text]).is_some()) {
            self.next += 1;
            left = Expression::Binary(*operator, Box::new(left), Box::new(inner(self)?));
        }
        Ok(left)
    }

    fn or(&mut self) -> Parsed {
        self.chain(&[("||", Binary::Or)], Self::and)
    }

    fn and(&mut self) -> Parsed {
        self.chain(&[("&&", Binary::And)], Self::comparison)
    }

    fn comparison(&mut self) -> Parsed {
        let first = self.bit_or()?;
        let mut rest = Vec::new();
        while let Some(operator) = self.take(&["==", "!=", "<=", ">=", "<", ">"]) {
            let comparison = match operator {
                "==" => Comparison::Equal,
                "!=" => Comparison::NotEqual,
                "<=" => Comparison::LessOrEqual,
                ">=" => Comparison::GreaterOrEqual,
                "<" => Comparison::Less,
                _ => Comparison::Greater,
            };
            rest.push((comparison, self.bit_or()?));
        }
        Ok(if rest.is_empty() {
            first
        } else {
            Expression::Compare(Box::new(first), rest)
        })
    }

    fn bit_or(&mut self) -> Parsed {
        self.chain(&[("|", Binary::BitOr), ("^", Binary::BitXor)], Self::bit_and)
    }

    fn bit_and(&mut self) -> Parsed {
        self.chain(&[("&", Binary::BitAnd)], Self::sum)
    }

    fn sum(&mut self) -> Parsed {
        let operators = [("..", Binary::Concatenate), ("+", Binary::Add), ("-", Binary::Subtract)];
        self.chain(&operators, Self::product)
    }

    fn product(&mut self) -> Parsed {
        self.chain(&[("*", Binary::Multiply), ("/", Binary::Divide)], Self::prefix)
    }

    fn prefix(&mut self) -> Parsed {
        let operator = match self.take(&["-", "!", "~"]) {
            None => return self.primary(),
            Some("-") => Unary::Minus,
            Some("!") => Unary::Not,
            Some(_) => Unary::Complement,
        };
        Ok(Expression::Unary(operator, Box::new(self.nested(Self::prefix)?)))
    }

    fn primary(&mut self) -> Parsed {
        if self.take(&["("]).is_some() {
            let inner = self.nested(Self::assignment)?;
            if self.take(&[")"]).is_none() {
                return Err(self.unexpected("a closing )"));
            }
            return Ok(inner);
        }
        let expression = match self.words.get(self.next) {
            Some((Word::Name(name), _)) => match name.as_str() {
                "true" => Expression::Literal(Value::Double(1.0)),
                "false" => Expression::Literal(Value::Double(0.0)),
                name => Expression::Variable(name.to_owned()),
            },
            Some((Word::Int(value), _)) => Expression::Literal(Value::Int(*value)),
            Some((Word::Double(value), _)) => Expression::Literal(Value::Double(*value)),
            Some((Word::Text(text), _)) => Expression::Literal(Value::text(text)),
            _ => return Err(self.unexpected("a name, a number, 'text' or (")),
        };
        self.next += 1;
        Ok(expression)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_parse_says_where_and_what_was_expected() {
        for (script, at, expected) in [
            ("", 1, "at least one statement"),
            ("a := ", 6, "a name, a number, 'text' or ("),
            ("(a", 3, "a closing )"),
            ("a ? b", 6, "the : of ?:"),
            ("1 = 2", 3, "a name on the left of an assignment"),
            ("a b", 3, "an operator or ;"),
            ("a := 'x", 6, "a closing '"),
            ("a # b", 3, "a name, a number, 'text' or an operator"),
        ] {
            let wrong = parse(script).unwrap_err();
            assert_eq!((wrong.at, wrong.expected.as_str()), (at, expected), "{script}");
        }
    }

    #[test]
    fn length_and_nesting_are_bounded() {
        assert!(parse(&"(".repeat(5000)).is_err());
        assert!(parse(&"!".repeat(5000)).is_err());
        assert!(parse(&"a+".repeat(1000)).is_err());
        assert!(parse(&format!("{}1", "a=".repeat(100))).is_err());
        assert!(parse(&"a".repeat(10_000)).is_err());
        assert!(parse(&format!("a{}", "+a".repeat(200))).is_ok());
    }
}
