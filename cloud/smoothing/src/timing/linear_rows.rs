//! Rows of a programme. Linear forms of up to three consecutive unknowns, each at most one.

use clarabel::algebra::CscMatrix;

use crate::csc::by_columns;

/// `factors · x[first..] + constant`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Form {
    pub(super) first: usize,
    pub(super) factors: [f64; 3],
    pub(super) constant: f64,
}

impl Form {
    /// One unknown.
    pub(super) fn unknown(index: usize) -> Self {
        Self {
            first: index,
            factors: [1.0, 0.0, 0.0],
            constant: 0.0,
        }
    }

    pub(super) fn constant(constant: f64) -> Self {
        Self {
            constant,
            ..Self::default()
        }
    }

    pub(super) fn scaled(self, factor: f64) -> Self {
        Self {
            factors: self.factors.map(|f| f * factor),
            constant: self.constant * factor,
            ..self
        }
    }

    /// The sum; the unknowns of both lie within three consecutive ones.
    pub(super) fn plus(self, other: Self) -> Self {
        let (low, high) = if self.is_constant() {
            (other, self)
        } else if other.is_constant() || self.first <= other.first {
            (self, other)
        } else {
            (other, self)
        };
        let mut sum = low;
        sum.constant += high.constant;
        if !high.is_constant() {
            let shift = high.first - low.first;
            for (i, factor) in high
                .factors
                .into_iter()
                .enumerate()
                .filter(|(_, factor)| *factor != 0.0)
            {
                sum.factors[i + shift] += factor;
            }
        }
        sum
    }

    pub(super) fn is_constant(&self) -> bool {
        self.factors == [0.0; 3]
    }

    pub(super) fn at(&self, x: &[f64]) -> f64 {
        let terms = self.factors.iter().zip(x.iter().skip(self.first));
        terms.map(|(factor, x)| factor * x).sum::<f64>() + self.constant
    }
}

/// Rows, each at most one.
pub(super) struct Rows {
    pub(super) rows: Vec<Form>,
}

impl Rows {
    pub(super) fn at_most(&mut self, form: Form, bound: f64) {
        self.rows.push(form.scaled(1.0 / bound));
    }

    pub(super) fn within(&mut self, form: Form, bound: f64) {
        self.rows.extend([form.scaled(1.0 / bound), form.scaled(-1.0 / bound)]);
    }
}

/// The rows `row <= 1` in the solver's format, by columns.
pub(super) fn columns(rows: &[Form], unknowns: usize) -> (CscMatrix<f64>, Vec<f64>) {
    let entries = || {
        rows.iter().enumerate().flat_map(|(index, row)| {
            let factors = row.factors.into_iter().zip(row.first..);
            factors
                .filter(|(factor, _)| *factor != 0.0)
                .map(move |(factor, unknown)| (index, unknown, factor))
        })
    };
    let bounds = rows.iter().map(|row| 1.0 - row.constant).collect();
    (by_columns(rows.len(), unknowns, entries), bounds)
}
