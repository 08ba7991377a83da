//! Conversion of nalgebra's types to parry's. (parry uses `glam`; this is the only place that converts.)

use nalgebra::Point2;
use parry2d_f64::bounding_volume::Aabb;
use parry2d_f64::math::Vector;

/// A point as parry's vector.
pub(crate) fn vector(point: Point2<f64>) -> Vector {
    Vector::new(point.x, point.y)
}

/// The box around a disc.
pub(crate) fn around(center: Point2<f64>, radius: f64) -> Aabb {
    Aabb::from_half_extents(vector(center), Vector::new(radius, radius))
}
