//! Cost. The quadratic form of a curve's length, curvature and change of curvature, over the positions and derivatives at its joints.

use clarabel::algebra::CscMatrix;
use nalgebra::{Matrix6, Vector6};

use super::corridor::FreePolygon;

/// Variables per joint: `px py vx vy ax ay`.
pub(super) const JOINT: usize = 6;

/// Control points of a piece as sums of (joint 0 or 1, order of the derivative, factor).
pub(super) fn controls(length: f64) -> [[(usize, usize, f64); 3]; 6] {
    let (v, a) = (length / 5.0, length * length / 20.0);
    let none = |joint| (joint, 1, 0.0);
    [
        [(0, 0, 1.0), none(0), (0, 2, 0.0)],
        [(0, 0, 1.0), (0, 1, v), (0, 2, 0.0)],
        [(0, 0, 1.0), (0, 1, 2.0 * v), (0, 2, a)],
        [(1, 0, 1.0), (1, 1, -2.0 * v), (1, 2, a)],
        [(1, 0, 1.0), (1, 1, -v), (1, 2, 0.0)],
        [(1, 0, 1.0), none(1), (1, 2, 0.0)],
    ]
}

/// The cost's matrix (upper triangle).
pub(super) fn cost(polygons: &[FreePolygon], turning_length: f64) -> CscMatrix<f64> {
    let units = unit_costs();
    let weights = [1.0, turning_length.powi(2), turning_length.powi(4)];
    let block = |polygon: &FreePolygon| {
        // Derivatives are by the share of the piece, not by its length: each order has one more factor of the length.
        let length = polygon.length;
        let scale = Vector6::new(1.0, length, length * length, 1.0, length, length * length);
        let weights = [0, 1, 2].map(|order| weights[order] * length.powi(-1 - 2 * order as i32));
        let sum = units[0] * weights[0] + units[1] * weights[1] + units[2] * weights[2];
        sum.component_mul(&(scale * scale.transpose()))
    };
    let blocks: Vec<Matrix6<f64>> = polygons.iter().map(block).collect();
    let variables = JOINT * (polygons.len() + 1);
    let (mut starts, mut indices, mut values) = (vec![0], Vec::new(), Vec::new());
    for variable in 0..variables {
        let (joint, order, axis) = (variable / JOINT, variable % JOINT / 2, variable % 2);
        let before = joint.checked_sub(1).map(|i| &blocks[i]);
        let after = blocks.get(joint);
        if let Some(block) = before {
            for other in 0..3 {
                indices.push(JOINT * (joint - 1) + 2 * other + axis);
                values.push(2.0 * block[(other, 3 + order)]);
            }
        }
        for other in 0..=order {
            indices.push(JOINT * joint + 2 * other + axis);
            let sum = before.map_or(0.0, |block| block[(3 + other, 3 + order)])
                + after.map_or(0.0, |block| block[(other, order)]);
            values.push(2.0 * sum);
        }
        starts.push(indices.len());
    }
    CscMatrix::new(variables, variables, starts, indices, values)
}

/// Integrals of the squared first, second and third derivative of a piece of length one, over `(p, v, a)` of its start and end, one axis.
fn unit_costs() -> [Matrix6<f64>; 3] {
    let mut derivative = Matrix6::zeros();
    for (i, control) in controls(1.0).iter().enumerate() {
        for (joint, order, factor) in control {
            derivative[(i, 3 * joint + order)] += factor;
        }
    }
    // Differences of neighbouring control points are the control points of the derivative, up to a factor.
    [4, 3, 2].map(|degree| {
        for i in 0..=degree {
            let difference = (derivative.row(i + 1) - derivative.row(i)) * (degree + 1) as f64;
            derivative.set_row(i, &difference);
        }
        let mut sum = Matrix6::zeros();
        for i in 0..=degree {
            for j in 0..=degree {
                let product =
                    binomial(degree, i) * binomial(degree, j) / binomial(2 * degree, i + j) / (2 * degree + 1) as f64;
                sum += derivative.row(i).transpose() * derivative.row(j) * product;
            }
        }
        sum
    })
}

fn binomial(n: usize, k: usize) -> f64 {
    (0..k).map(|i| (n - i) as f64 / (i + 1) as f64).product()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_costs_are_the_integrals_of_known_polynomials() {
        // u, u^2 and u^3 over 0 to 1, by position, first and second derivative at both ends.
        let line = Vector6::new(0.0, 1.0, 0.0, 1.0, 1.0, 0.0);
        let square = Vector6::new(0.0, 0.0, 2.0, 1.0, 2.0, 2.0);
        let cube = Vector6::new(0.0, 0.0, 0.0, 1.0, 3.0, 6.0);
        let integral = |of: Vector6<f64>| unit_costs().map(|cost| of.dot(&(cost * of)));
        let known = [
            (line, [1.0, 0.0, 0.0]),
            (square, [4.0 / 3.0, 4.0, 0.0]),
            (cube, [9.0 / 5.0, 12.0, 36.0]),
        ];
        for (of, expected) in known {
            for (found, expected) in integral(of).into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-9, "{found} {expected}");
            }
        }
    }
}
