//! Scripts. What does `x := a + 1; y = x > 3 ? 'far' : 'near'` do? The scripting language of BehaviorTree.CPP v4, for `Script`,
//! `ScriptCondition` and the conditions around nodes.
//!
//! A script is parsed when the tree is checked, its names are resolved to slots of the blackboard when the tree is built, and a run only
//! evaluates it. Its length, its nesting and the text it can create are bounded.

mod evaluate;
mod parse;
mod token;

use std::collections::BTreeMap;
use std::sync::Arc;

use super::blackboard::{Blackboard, Slot};
use super::value::Value;

pub(crate) use evaluate::{is_same, truth};
pub(crate) use parse::parse;

/// An expression; `V` is the type of variables: text when parsed, slots when bound.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Expression<V> {
    Literal(Value),
    Variable(V),
    Unary(Unary, Box<Expression<V>>),
    Binary(Binary, Box<Expression<V>>, Box<Expression<V>>),
    /// `a < b <= c`: every neighbouring pair must hold.
    Compare(Box<Expression<V>>, Vec<(Comparison, Expression<V>)>),
    Ternary(Box<[Expression<V>; 3]>),
    Assign {
        to: V,
        operator: Assignment,
        value: Box<Expression<V>>,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unary {
    Minus,
    Not,
    Complement,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
    Concatenate,
    BitAnd,
    BitOr,
    BitXor,
    And,
    Or,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Comparison {
    Equal,
    NotEqual,
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Assignment {
    /// `:=`, creates the entry if necessary.
    Create,
    /// `=`, only for an entry that has a value.
    Existing,
    /// `+=` and the like.
    Update(Binary),
}

/// A script that does not parse.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}, at character {at}: expected {expected}")]
pub(crate) struct ScriptSyntax {
    /// Character of the script, from 1.
    pub(crate) at: usize,
    /// The error.
    pub(crate) message: String,
    /// What was expected.
    pub(crate) expected: String,
}

/// Why a script could not be evaluated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum ScriptError {
    #[error("the entry `{0}` has no value")]
    Empty(String),
    #[error("`{0}` is {1}: expected {2}")]
    Type(String, &'static str, &'static str),
    #[error("text of more than {0} bytes")]
    TooLong(usize),
    #[error("`{0}`: {1}")]
    Assign(String, super::TypeError),
}

/// A variable of a bound script.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Variable {
    pub(crate) slot: Slot,
    pub(crate) name: Box<str>,
}

/// Names of numbers.
pub(crate) type Enums = BTreeMap<String, i64>;

/// A script bound to a scope of a blackboard.
#[derive(Debug, Clone)]
pub(crate) struct Program {
    text: Box<str>,
    statements: Vec<Expression<Variable>>,
    /// Names that text may contain where a number is required.
    enums: Arc<Enums>,
}

impl Program {
    /// Assigns a slot to every variable; names in `enums` are numbers.
    pub(crate) fn bind(
        text: &str,
        statements: Vec<Expression<String>>,
        enums: &Arc<Enums>,
        resolve: &mut dyn FnMut(&str) -> Slot,
    ) -> Program {
        let statements = statements
            .into_iter()
            .map(|statement| bind(statement, enums, resolve))
            .collect();
        Program {
            text: text.into(),
            statements,
            enums: enums.clone(),
        }
    }

    /// The original text of the script.
    pub(crate) fn text(&self) -> &str {
        &self.text
    }

    /// Evaluates every statement; the value of the last one is the value of the script.
    pub(crate) fn run(&self, board: &mut Blackboard) -> Result<Value, ScriptError> {
        let mut last = Value::Bool(true);
        for statement in &self.statements {
            last = evaluate::evaluate(statement, board, &self.enums)?;
        }
        Ok(last)
    }
}

fn variable(name: String, resolve: &mut dyn FnMut(&str) -> Slot) -> Variable {
    Variable {
        slot: resolve(&name),
        name: name.into(),
    }
}

fn bind(expression: Expression<String>, enums: &Enums, resolve: &mut dyn FnMut(&str) -> Slot) -> Expression<Variable> {
    match expression {
        Expression::Literal(value) => Expression::Literal(value),
        Expression::Variable(name) => match enums.get(&name) {
            Some(number) => Expression::Literal(Value::Double(*number as f64)),
            None => Expression::Variable(variable(name, resolve)),
        },
        Expression::Unary(operator, inner) => Expression::Unary(operator, Box::new(bind(*inner, enums, resolve))),
        Expression::Binary(operator, left, right) => Expression::Binary(
            operator,
            Box::new(bind(*left, enums, resolve)),
            Box::new(bind(*right, enums, resolve)),
        ),
        Expression::Compare(first, rest) => Expression::Compare(
            Box::new(bind(*first, enums, resolve)),
            rest.into_iter()
                .map(|(comparison, next)| (comparison, bind(next, enums, resolve)))
                .collect(),
        ),
        Expression::Ternary(parts) => Expression::Ternary(Box::new(parts.map(|part| bind(part, enums, resolve)))),
        Expression::Assign { to, operator, value } => Expression::Assign {
            to: variable(to, resolve),
            operator,
            value: Box::new(bind(*value, enums, resolve)),
        },
    }
}
