//! World checks. Values must be finite and bounded, and outlines must enclose an area; errors name the line.

use std::ops::Range;

use nalgebra::Point2;
use thiserror::Error;
use toml::Spanned;
use zenav_protocol::config_text::{self, Expected, Number, Pair, TextError};
use zenav_protocol::geometry::MAX_COORDINATE;
use zenav_protocol::polygon;

/// Largest number of polygons, circles and walls, each.
pub const MAX_SHAPES: usize = 20_000;
/// Largest number of corners of one polygon or path.
pub const MAX_CORNERS: usize = 1_000;
/// Largest number of corners of all polygons together.
pub const MAX_ALL_CORNERS: usize = 200_000;
/// Largest number of movers, doors, places and faults, each.
pub const MAX_MOVERS: usize = 1_000;
/// Longest rest of a mover or door, s.
pub const MAX_REST: f64 = 86_400.0;
/// Largest speed of a mover, m/s.
pub const MAX_MOVER_SPEED: f64 = 20.0;

/// Why a world was refused.
#[derive(Debug, Error)]
pub enum WorldError {
    /// No world of this name is shipped.
    #[error("no shipped world is named `{name}`: there are {known}")]
    Unknown {
        /// The name that was asked for.
        name: String,
        /// The names that are known.
        known: String,
    },
    /// The file's text does not fit.
    #[error(transparent)]
    File(#[from] TextError),
}

/// The text of a file, and the checks of its values.
#[derive(Clone, Copy)]
pub(crate) struct Source<'a>(pub config_text::Source<'a>);

impl Source<'_> {
    pub fn fail<T>(self, span: Range<usize>, key: &'static str, problem: impl Into<String>) -> Result<T, WorldError> {
        Err(self.0.refused(span.start, key, problem).into())
    }

    pub fn positive(self, value: &Spanned<f64>, key: &'static str) -> Result<f64, WorldError> {
        let number = *value.get_ref();
        if number > 0.0 && number <= MAX_COORDINATE {
            Ok(number)
        } else {
            self.fail(
                value.span(),
                key,
                format!("{}: expected a positive number up to {MAX_COORDINATE}", Number(number)),
            )
        }
    }

    pub fn coordinates(self, span: Range<usize>, key: &'static str, values: &[f64]) -> Result<(), WorldError> {
        match values
            .iter()
            .find(|value| !value.is_finite() || value.abs() > MAX_COORDINATE)
        {
            None => Ok(()),
            Some(value) => {
                let problem = format!("{}: expected a number within {MAX_COORDINATE}", Number(*value));
                self.fail(span, key, problem)
            }
        }
    }

    /// A heading, rad.
    pub fn heading(self, span: Range<usize>, key: &'static str, yaw: f64) -> Result<(), WorldError> {
        match Expected::Angle.check(yaw) {
            Ok(_) => Ok(()),
            Err(problem) => self.fail(span, key, problem),
        }
    }

    pub fn points(
        self,
        points: &Spanned<Vec<Pair>>,
        key: &'static str,
        least: usize,
    ) -> Result<Vec<Point2<f64>>, WorldError> {
        let count = points.get_ref().len();
        if !(least..=MAX_CORNERS).contains(&count) {
            return self.fail(
                points.span(),
                key,
                format!("{count} points: expected {least} to {MAX_CORNERS}"),
            );
        }
        for Pair(point) in points.get_ref() {
            self.coordinates(points.span(), key, point)?;
        }
        Ok(points.get_ref().iter().copied().map(Point2::from).collect())
    }

    /// A simple polygon, brought into counter-clockwise order.
    pub fn polygon(self, points: &Spanned<Vec<Pair>>, key: &'static str) -> Result<Vec<Point2<f64>>, WorldError> {
        let corners = self.points(points, key, 3)?;
        polygon::simple(corners).or_else(|error| self.fail(points.span(), key, error.to_string()))
    }

    pub fn count(self, count: usize, limit: usize, key: &'static str) -> Result<(), WorldError> {
        if count <= limit {
            Ok(())
        } else {
            self.fail(0..0, key, format!("{count} of them: expected at most {limit}"))
        }
    }
}
