//! Compressed columns. A sparse matrix in the form that the solver takes.

use clarabel::algebra::CscMatrix;

/// The matrix of entries (row, column, value), given row by row, as often as asked for; linear in their number.
pub(crate) fn by_columns<I>(rows: usize, columns: usize, entries: impl Fn() -> I) -> CscMatrix<f64>
where
    I: Iterator<Item = (usize, usize, f64)>,
{
    let mut starts = vec![0; columns + 1];
    for (_, column, _) in entries() {
        starts[column + 1] += 1;
    }
    for column in 0..columns {
        starts[column + 1] += starts[column];
    }
    let mut next = starts.clone();
    let (mut indices, mut values) = (vec![0; starts[columns]], vec![0.0; starts[columns]]);
    for (row, column, value) in entries() {
        let at = &mut next[column];
        (indices[*at], values[*at]) = (row, value);
        *at += 1;
    }
    CscMatrix::new(rows, columns, starts, indices, values)
}
