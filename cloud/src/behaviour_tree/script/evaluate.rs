//! What is the value of a script? Integers stay integers while they can, everything else that is
//! numeric is a float; text joins with `..`.

use super::{Assignment, Binary, Comparison, Expression, ScriptError, Unary, Variable};
use crate::behaviour_tree::blackboard::Blackboard;
use crate::behaviour_tree::value::Value;

/// Longest text that a script may make, bytes: `s = s .. s` must not eat the memory.
const TEXT: usize = 64 * 1024;

type Computed = Result<Value, ScriptError>;

/// What a condition makes of a value: numbers hold if they are not 0.
pub(crate) fn truth(value: &Value) -> Option<bool> {
    match value {
        Value::Int(value) => Some(*value != 0),
        Value::Double(value) => Some(*value != 0.0),
        other => other.as_bool(),
    }
}

pub(super) fn evaluate(expression: &Expression<Variable>, board: &mut Blackboard) -> Computed {
    match expression {
        Expression::Literal(value) => Ok(value.clone()),
        Expression::Variable(variable) => read(variable, board).cloned(),
        Expression::Unary(operator, inner) => unary(*operator, evaluate(inner, board)?),
        Expression::Binary(Binary::And, left, right) => {
            Ok(Value::Bool(condition(left, board)? && condition(right, board)?))
        }
        Expression::Binary(Binary::Or, left, right) => {
            Ok(Value::Bool(condition(left, board)? || condition(right, board)?))
        }
        Expression::Binary(operator, left, right) => {
            let left = evaluate(left, board)?;
            binary(*operator, left, evaluate(right, board)?)
        }
        Expression::Compare(first, rest) => {
            let mut left = evaluate(first, board)?;
            for (comparison, next) in rest {
                let right = evaluate(next, board)?;
                if !compare(*comparison, &left, &right)? {
                    return Ok(Value::Bool(false));
                }
                left = right;
            }
            Ok(Value::Bool(true))
        }
        Expression::Ternary(parts) => {
            let [question, yes, no] = &**parts;
            evaluate(if condition(question, board)? { yes } else { no }, board)
        }
        Expression::Assign { to, operator, value } => {
            let mut value = evaluate(value, board)?;
            match operator {
                Assignment::Create => {}
                Assignment::Existing => {
                    read(to, board)?;
                }
                Assignment::Update(binary_operator) => {
                    value = binary(*binary_operator, read(to, board)?.clone(), value)?;
                }
            }
            board
                .write(to.slot, value.clone())
                .map_err(|wrong| ScriptError::Assign(to.name.to_string(), wrong))?;
            Ok(value)
        }
    }
}

fn read<'b>(variable: &Variable, board: &'b Blackboard) -> Result<&'b Value, ScriptError> {
    board
        .read(variable.slot)
        .ok_or_else(|| ScriptError::Empty(variable.name.to_string()))
}

fn condition(expression: &Expression<Variable>, board: &mut Blackboard) -> Result<bool, ScriptError> {
    let value = evaluate(expression, board)?;
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

/// A number as the arithmetic sees it.
enum Number {
    Int(i64),
    Double(f64),
}

impl Number {
    fn of(value: &Value) -> Result<Number, ScriptError> {
        match value {
            Value::Double(value) => Ok(Number::Double(*value)),
            other => match other.as_int() {
                Some(value) => Ok(Number::Int(value)),
                None => other
                    .as_double()
                    .map(Number::Double)
                    .ok_or_else(|| unfit(other, "a number")),
            },
        }
    }

    fn double(&self) -> f64 {
        match self {
            Number::Int(value) => *value as f64,
            Number::Double(value) => *value,
        }
    }
}

fn unary(operator: Unary, value: Value) -> Computed {
    match operator {
        Unary::Not => truth(&value)
            .map(|truth| Value::Bool(!truth))
            .ok_or_else(|| unfit(&value, "true or false")),
        Unary::Complement => value
            .as_int()
            .map(|bits| Value::Int(!bits))
            .ok_or_else(|| unfit(&value, "an integer")),
        Unary::Minus => match Number::of(&value)? {
            Number::Int(value) => value.checked_neg().map(Value::Int).ok_or(ScriptError::Overflow),
            Number::Double(value) => Ok(Value::Double(-value)),
        },
    }
}

fn binary(operator: Binary, left: Value, right: Value) -> Computed {
    let texts = matches!((&left, &right), (Value::Text(_), Value::Text(_)));
    match operator {
        Binary::Concatenate => join(&left, &right),
        Binary::Add if texts => join(&left, &right),
        Binary::BitAnd | Binary::BitOr | Binary::BitXor => {
            let bits = |value: &Value| value.as_int().ok_or_else(|| unfit(value, "an integer"));
            let (left, right) = (bits(&left)?, bits(&right)?);
            Ok(Value::Int(match operator {
                Binary::BitAnd => left & right,
                Binary::BitOr => left | right,
                _ => left ^ right,
            }))
        }
        _ => arithmetic(operator, Number::of(&left)?, Number::of(&right)?),
    }
}

fn join(left: &Value, right: &Value) -> Computed {
    let joined = format!("{left}{right}");
    if joined.len() > TEXT {
        return Err(ScriptError::TooLong(TEXT));
    }
    Ok(Value::from(joined))
}

fn arithmetic(operator: Binary, left: Number, right: Number) -> Computed {
    if matches!(operator, Binary::Divide) && right.double() == 0.0 {
        return Err(ScriptError::ZeroDivision);
    }
    if let (Number::Int(left), Number::Int(right)) = (&left, &right) {
        let whole = match operator {
            Binary::Add => left.checked_add(*right),
            Binary::Subtract => left.checked_sub(*right),
            Binary::Multiply => left.checked_mul(*right),
            // As in BehaviorTree.CPP 5 / 2 is 2.5; what divides evenly stays an integer.
            _ if left.checked_rem(*right) == Some(0) => left.checked_div(*right),
            _ => return Ok(Value::Double(*left as f64 / *right as f64)),
        };
        return whole.map(Value::Int).ok_or(ScriptError::Overflow);
    }
    let (left, right) = (left.double(), right.double());
    Ok(Value::Double(match operator {
        Binary::Add => left + right,
        Binary::Subtract => left - right,
        Binary::Multiply => left * right,
        _ => left / right,
    }))
}

fn compare(comparison: Comparison, left: &Value, right: &Value) -> Result<bool, ScriptError> {
    use std::cmp::Ordering;
    let order = match (left, right) {
        (Value::Text(left), Value::Text(right)) => Some(left.cmp(right)),
        (Value::Int(left), Value::Int(right)) => Some(left.cmp(right)),
        _ => match (Number::of(left), Number::of(right)) {
            (Ok(left), Ok(right)) => {
                let (left, right) = (left.double(), right.double());
                // Floats that differ by less are equal, as in BehaviorTree.CPP.
                if (left - right).abs() < f64::from(f32::EPSILON) {
                    Some(Ordering::Equal)
                } else {
                    left.partial_cmp(&right)
                }
            }
            _ => None,
        },
    };
    match (comparison, order) {
        (Comparison::Equal, Some(order)) => Ok(order == Ordering::Equal),
        (Comparison::NotEqual, Some(order)) => Ok(order != Ordering::Equal),
        (Comparison::Equal, None) => Ok(left == right),
        (Comparison::NotEqual, None) => Ok(left != right),
        (Comparison::Less, Some(order)) => Ok(order == Ordering::Less),
        (Comparison::LessOrEqual, Some(order)) => Ok(order != Ordering::Greater),
        (Comparison::Greater, Some(order)) => Ok(order == Ordering::Greater),
        (Comparison::GreaterOrEqual, Some(order)) => Ok(order != Ordering::Less),
        (_, None) => Err(unfit(if Number::of(left).is_ok() { right } else { left }, "comparable")),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use std::collections::BTreeMap;

    use super::super::{Program, parse};
    use super::*;

    fn run(board: &mut Blackboard, script: &str) -> Result<Value, ScriptError> {
        let enums = BTreeMap::from([("RED".to_owned(), 1)]);
        let statements = parse(script).unwrap();
        Program::bind(script, statements, &enums, &mut |name| board.resolve(0, name)).run(board)
    }

    fn value(script: &str) -> Value {
        run(&mut Blackboard::default(), script).unwrap()
    }

    #[test]
    fn operators_bind_as_in_behaviortree_cpp() {
        assert_eq!(value("1 + 2 * 3"), Value::Int(7));
        assert_eq!(value("(1 + 2) * 3"), Value::Int(9));
        assert_eq!(value("-2 * -3"), Value::Int(6));
        assert_eq!(value("5 / 2"), Value::Double(2.5));
        assert_eq!(value("6 / 2"), Value::Int(3));
        assert_eq!(value("1 | 2 & 3"), Value::Int(3));
        assert_eq!(value("~0 ^ 0xF"), Value::Int(-16));
        assert_eq!(value("1 + 1 == 2 && !false"), Value::Bool(true));
        assert_eq!(value("1 < 2 <= 2 < 3"), Value::Bool(true));
        assert_eq!(value("1 < 2 < 2"), Value::Bool(false));
        assert_eq!(value("'a' .. 1 + 2 .. 'b'"), Value::text("a3b"));
        assert_eq!(value("RED == 1 ? 'yes' : 'no'"), Value::text("yes"));
        assert_eq!(value("0.1 + 0.2 == 0.3"), Value::Bool(true));
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
    fn the_other_side_of_a_decided_condition_is_not_computed() {
        assert_eq!(value("false && missing"), Value::Bool(false));
        assert_eq!(value("true || missing"), Value::Bool(true));
        assert_eq!(value("true ? 1 : missing"), Value::Int(1));
    }

    #[test]
    fn what_cannot_be_computed_is_an_error_not_a_panic() {
        let mut board = Blackboard::default();
        assert_eq!(run(&mut board, "1 / 0"), Err(ScriptError::ZeroDivision));
        let most = format!("{} + 1", i64::MAX);
        assert_eq!(run(&mut board, &most), Err(ScriptError::Overflow));
        assert!(run(&mut board, "'a' < 1").is_err());
        assert!(run(&mut board, "'a' && true").is_err());
        run(&mut board, "s := 'xxxxxxxxxxxxxxxx'").unwrap();
        let doubled = (0..20).map(|_| run(&mut board, "s = s .. s")).find(Result::is_err);
        assert_eq!(doubled, Some(Err(ScriptError::TooLong(TEXT))));
    }
}
