//! Evaluation. What is the value of a script? As in BehaviorTree.CPP, only an integer literal is an integer; everything computed (sums,
//! signs, comparisons, truth values) and every named number is a float. `..` joins text.
//!
//! More lenient than BehaviorTree.CPP: every number but 0 is true, text `true` and `false` are truth values, `..` joins two numbers, and text
//! that is no number differs from every number.

use super::{Assignment, Binary, Comparison, Enums, Expression, ScriptError, Unary, Variable};
use crate::blackboard::Blackboard;
use crate::value::{Value, ValueType, truth_word};

/// Longest text that a script may create, bytes: `s = s .. s` must not exhaust the memory.
const TEXT: usize = 64 * 1024;

type Computed = Result<Value, ScriptError>;

/// A value as a condition: numbers are true if they are not 0.
pub(crate) fn truth(value: &Value) -> Option<bool> {
    match value {
        Value::Int(value) => Some(*value != 0),
        Value::Double(value) => Some(*value != 0.0),
        other => other.as_bool(),
    }
}

fn said(truth: bool) -> Value {
    Value::Double(f64::from(u8::from(truth)))
}

pub(super) fn evaluate(expression: &Expression<Variable>, board: &mut Blackboard, enums: &Enums) -> Computed {
    match expression {
        Expression::Literal(value) => Ok(value.clone()),
        Expression::Variable(variable) => read(variable, board).cloned(),
        Expression::Unary(operator, inner) => unary(*operator, evaluate(inner, board, enums)?),
        // Both sides are always evaluated, as in BehaviorTree.CPP.
        Expression::Binary(operator @ (Binary::And | Binary::Or), left, right) => {
            let (left, right) = (condition(left, board, enums)?, condition(right, board, enums)?);
            Ok(said(match operator {
                Binary::And => left && right,
                _ => left || right,
            }))
        }
        Expression::Binary(operator, left, right) => {
            let left = evaluate(left, board, enums)?;
            binary(*operator, left, evaluate(right, board, enums)?)
        }
        Expression::Compare(first, rest) => {
            let mut left = evaluate(first, board, enums)?;
            for (comparison, next) in rest {
                let right = evaluate(next, board, enums)?;
                if !compare(*comparison, &left, &right, enums)? {
                    return Ok(said(false));
                }
                left = right;
            }
            Ok(said(true))
        }
        Expression::Ternary(parts) => {
            let [question, yes, no] = &**parts;
            let chosen = if condition(question, board, enums)? { yes } else { no };
            evaluate(chosen, board, enums)
        }
        Expression::Assign { to, operator, value } => {
            let value = evaluate(value, board, enums)?;
            let value = match operator {
                Assignment::Create => value,
                Assignment::Existing => {
                    // An entry named by a port exists.
                    if !board.is_declared(to.slot) {
                        read(to, board)?;
                    }
                    value
                }
                Assignment::Update(operator) => binary(*operator, read(to, board)?.clone(), value)?,
            };
            // Text for an entry that holds a number may be the name of a number.
            let value = match (&value, board.kind(to.slot)) {
                (Value::Text(text), Some(ValueType::Int | ValueType::Double)) => {
                    enums.get(&**text).map_or(value, |number| Value::Int(*number))
                }
                _ => value,
            };
            board
                .write(to.slot, value)
                .map_err(|wrong| ScriptError::Assign(to.name.to_string(), wrong))?;
            read(to, board).cloned()
        }
    }
}

fn read<'b>(variable: &Variable, board: &'b Blackboard) -> Result<&'b Value, ScriptError> {
    board
        .read(variable.slot)
        .ok_or_else(|| ScriptError::Empty(variable.name.to_string()))
}

fn condition(expression: &Expression<Variable>, board: &mut Blackboard, enums: &Enums) -> Result<bool, ScriptError> {
    let value = evaluate(expression, board, enums)?;
    truth(&value).ok_or_else(|| unfit(&value, "true or false"))
}

fn unfit(value: &Value, expected: &'static str) -> ScriptError {
    let kind = match value {
        Value::Bool(_) => "a truth value",
        Value::Int(_) | Value::Double(_) => "a number",
        Value::Text(_) => "text",
        Value::Data(_) => "structured data",
    };
    ScriptError::Type(value.to_string().chars().take(60).collect(), kind, expected)
}

/// A value as a number for arithmetic. Integers beyond 2^53 are rounded.
fn number(value: &Value) -> Result<f64, ScriptError> {
    match value {
        Value::Int(value) => Ok(*value as f64),
        other => other.as_double().ok_or_else(|| unfit(other, "a number")),
    }
}

/// A value as bits.
fn bits(value: &Value) -> Result<i64, ScriptError> {
    value.as_int().ok_or_else(|| unfit(value, "an integer"))
}

fn unary(operator: Unary, value: Value) -> Computed {
    match operator {
        Unary::Not => truth(&value)
            .map(|truth| said(!truth))
            .ok_or_else(|| unfit(&value, "true or false")),
        Unary::Complement => Ok(Value::Double(!bits(&value)? as f64)),
        Unary::Minus => Ok(Value::Double(-number(&value)?)),
    }
}

fn binary(operator: Binary, left: Value, right: Value) -> Computed {
    let texts = matches!((&left, &right), (Value::Text(_), Value::Text(_)));
    Ok(Value::Double(match operator {
        Binary::Concatenate => return join(&left, &right),
        Binary::Add if texts => return join(&left, &right),
        Binary::BitAnd => (bits(&left)? & bits(&right)?) as f64,
        Binary::BitOr => (bits(&left)? | bits(&right)?) as f64,
        Binary::BitXor => (bits(&left)? ^ bits(&right)?) as f64,
        Binary::Add => number(&left)? + number(&right)?,
        Binary::Subtract => number(&left)? - number(&right)?,
        Binary::Multiply => number(&left)? * number(&right)?,
        // Division by zero gives infinity, as in BehaviorTree.CPP.
        Binary::Divide => number(&left)? / number(&right)?,
        Binary::And | Binary::Or => return Err(unfit(&left, "a number")),
    }))
}

fn join(left: &Value, right: &Value) -> Computed {
    let joined = format!("{left}{right}");
    if joined.len() > TEXT {
        return Err(ScriptError::TooLong(TEXT));
    }
    Ok(Value::from(joined))
}

/// A side of a comparison as a number; text compared with a number may be `true`, `false` or the name of a number.
fn compared(value: &Value, enums: &Enums) -> Option<f64> {
    match value {
        Value::Text(text) => truth_word(text)
            .map(|truth| f64::from(u8::from(truth)))
            .or_else(|| enums.get(&**text).map(|number| *number as f64))
            .or_else(|| value.as_double()),
        other => number(other).ok(),
    }
}

fn compare(comparison: Comparison, left: &Value, right: &Value, enums: &Enums) -> Result<bool, ScriptError> {
    use std::cmp::Ordering;
    let order = match (left, right) {
        (Value::Text(left), Value::Text(right)) => Some(left.cmp(right)),
        (Value::Int(left), Value::Int(right)) => Some(left.cmp(right)),
        _ => match (compared(left, enums), compared(right, enums)) {
            (Some(left), Some(right)) => match comparison {
                Comparison::Equal => return Ok(is_same(left, right)),
                Comparison::NotEqual => return Ok(!is_same(left, right)),
                _ => left.partial_cmp(&right),
            },
            // Text that is not a number equals none.
            _ if matches!(comparison, Comparison::Equal | Comparison::NotEqual) => {
                return Ok((left == right) == matches!(comparison, Comparison::Equal));
            }
            (Some(_), None) => return Err(unfit(right, "comparable")),
            (None, _) => return Err(unfit(left, "comparable")),
        },
    };
    Ok(match comparison {
        Comparison::Equal => order == Some(Ordering::Equal),
        Comparison::NotEqual => order != Some(Ordering::Equal),
        Comparison::Less => order == Some(Ordering::Less),
        Comparison::LessOrEqual => matches!(order, Some(Ordering::Less | Ordering::Equal)),
        Comparison::Greater => order == Some(Ordering::Greater),
        Comparison::GreaterOrEqual => matches!(order, Some(Ordering::Greater | Ordering::Equal)),
    })
}

/// Numbers that differ by no more than the precision of a 32-bit float are the same, as in BehaviorTree.CPP.
pub(crate) fn is_same(left: f64, right: f64) -> bool {
    left == right || (left - right).abs() <= f64::from(f32::EPSILON)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use super::super::{Program, parse};
    use super::*;

    fn run(board: &mut Blackboard, script: &str) -> Result<Value, ScriptError> {
        let enums = Arc::new(BTreeMap::from([("RED".to_owned(), 1)]));
        let statements = parse(script).unwrap();
        Program::bind(script, statements, &enums, &mut |name| board.resolve(0, name)).run(board)
    }

    fn value(script: &str) -> Value {
        run(&mut Blackboard::default(), script).unwrap()
    }

    #[test]
    fn operators_bind_as_in_behaviortree_cpp() {
        assert_eq!(value("1 + 2 * 3"), Value::Double(7.0));
        assert_eq!(value("(1 + 2) * 3"), Value::Double(9.0));
        assert_eq!(value("-2 * -3"), Value::Double(6.0));
        assert_eq!(value("5 / 2"), Value::Double(2.5));
        assert_eq!(value("6 / 2"), Value::Double(3.0));
        assert_eq!(value("1 | 2 & 3"), Value::Double(3.0));
        assert_eq!(value("~0 ^ 0xF"), Value::Double(-16.0));
        assert_eq!(value("1 + 1 == 2 && !false"), Value::Double(1.0));
        assert_eq!(value("1 < 2 <= 2 < 3"), Value::Double(1.0));
        assert_eq!(value("1 < 2 < 2"), Value::Double(0.0));
        assert_eq!(value("'a' .. (1 + 2) .. 'b'"), Value::text("a3b"));
        assert_eq!(value("'1' .. 2 + '3'"), Value::text("123"));
        assert_eq!(value("RED == 1 ? 'yes' : 'no'"), Value::text("yes"));
        assert_eq!(value("0.1 + 0.2 == 0.3"), Value::Double(1.0));
        assert_eq!(value("1..2"), Value::text("12"));
        assert_eq!(value("1.5e1"), Value::Double(15.0));
    }

    #[test]
    fn entries_are_made_by_colon_equals_only_and_keep_their_type() {
        let mut board = Blackboard::default();
        assert_eq!(run(&mut board, "x = 1"), Err(ScriptError::Empty("x".into())));
        run(&mut board, "x := 1; x += 2; x *= 3; x -= 1; y := x / 8.0").unwrap();
        assert_eq!(board.get("x"), Some(&Value::Int(8)));
        assert_eq!(board.get("y"), Some(&Value::Double(1.0)));
        assert!(matches!(run(&mut board, "x = 'text'"), Err(ScriptError::Assign(..))));
        assert!(matches!(run(&mut board, "x /= 3"), Err(ScriptError::Assign(..))));
    }

    #[test]
    fn what_is_computed_is_a_float_and_a_bare_integer_is_none() {
        for script in [
            "x := -1; x = 0.5",
            "x := 1 + 1; x = 0.5",
            "x := 7 / 7; x = 1.5",
            "x := 3 > 2; x := 10",
            "x := true; x := 5",
            "x := !0; x = 0.5",
            "x := 6 & 3; x = 0.5",
            "x := RED; x = 0.5",
            "x := 0.5; x = 'true'",
            "x := 3; x = 'RED'",
        ] {
            assert!(run(&mut Blackboard::default(), script).is_ok(), "{script}");
        }
        let mut board = Blackboard::default();
        assert!(run(&mut board, "x := 1; x = 0.5").is_err());
        assert_eq!(run(&mut board, "x = 1 + 1"), Ok(Value::Int(2)));
        run(&mut board, "sum := 1 + 2; yes := 3 > 2").unwrap();
        assert_eq!(board.get("sum").and_then(Value::as_int), Some(3));
        assert_eq!(board.get("yes").and_then(Value::as_bool), Some(true));
        assert_eq!(value("1 / 0"), Value::Double(f64::INFINITY));
        assert_eq!(value("-1 / 0 < 0"), Value::Double(1.0));
        assert_eq!(value(&format!("{} + 1 > 9e18", i64::MAX)), Value::Double(1.0));
    }

    #[test]
    fn text_beside_a_number_is_compared_as_the_number_that_it_stands_for() {
        let mut board = Blackboard::default();
        board.set("yes", "true").unwrap();
        board.set("no", "false").unwrap();
        board.set("color", "RED").unwrap();
        board.set("flag", true).unwrap();
        for script in [
            "yes == true",
            "no == false",
            "false == no",
            "yes != no",
            "yes > 0",
            "color == RED",
            "color < 2",
            "flag == yes",
            "flag == 'true'",
            "'3' == 3",
            "'idle' != 3",
            "!('idle' == 3)",
        ] {
            assert_eq!(run(&mut board, script), Ok(Value::Double(1.0)), "{script}");
        }
        // Equality is approximate; greater and less are exact.
        assert_eq!(value("0.3 < 0.1 + 0.2"), Value::Double(1.0));
    }

    #[test]
    fn both_sides_of_a_condition_are_computed_and_one_of_a_choice() {
        let mut board = Blackboard::default();
        run(&mut board, "n := 0").unwrap();
        assert_eq!(run(&mut board, "false && (n += 1) > 0"), Ok(Value::Double(0.0)));
        assert_eq!(run(&mut board, "true || (n += 1) > 0"), Ok(Value::Double(1.0)));
        assert_eq!(board.get("n"), Some(&Value::Int(2)));
        assert!(run(&mut board, "false && missing").is_err());
        assert_eq!(value("true ? 1 : missing"), Value::Int(1));
    }

    #[test]
    fn what_cannot_be_computed_is_an_error_not_a_panic() {
        let mut board = Blackboard::default();
        assert!(run(&mut board, "1.5 | 1").is_err());
        assert!(run(&mut board, "-'a'").is_err());
        assert!(run(&mut board, "'a' < 1").is_err());
        assert!(run(&mut board, "'a' && true").is_err());
        run(&mut board, "s := 'xxxxxxxxxxxxxxxx'").unwrap();
        let doubled = (0..20).map(|_| run(&mut board, "s = s .. s")).find(Result::is_err);
        assert_eq!(doubled, Some(Err(ScriptError::TooLong(TEXT))));
    }
}
