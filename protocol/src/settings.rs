//! Settings. What can be tuned, in which unit, within which bounds, and what justifies the default?
//!
//! [`settings!`](crate::settings!) declares a section of settings in one place: each field with its doc line, type, default, unit and
//! bounds. It generates the struct (serde with unknown keys refused, `Default`), the check of its bounds, and the rows that
//! `zenav config show` prints. A field without a default is a nested section.

use std::fmt;
use std::ops::{Bound, RangeBounds};

use serde::{Serialize, de::DeserializeOwned};

use crate::config_text::{Number, OutOfBounds};

#[doc(hidden)]
pub use {serde, serde_json};

/// Declares a section of settings: see [the module](mod@crate::settings).
///
/// Each field is `name: type = default, "unit", bounds;`. The unit may be omitted if there are no bounds, and is `""` for a setting without
/// a unit; bounds are any range of numbers. A field without `= default` is a nested section, declared the same way. A closing
/// `check = function;` adds conditions beyond single bounds; it returns [`OutOfBounds`](crate::config_text::OutOfBounds).
///
/// ```
/// use zenav_protocol::settings::Settings;
///
/// zenav_protocol::settings! {
///     /// How much a path pays for running close to obstacles.
///     pub struct Clearance {
///         /// Cost of each metre at zero clearance (measured: 2 keeps 0.3 m in the kitchen).
///         pub weight: f64 = 2.0, "1/m", 0.0..=10.0;
///         /// Whether narrow passages are closed.
///         pub strict: bool = false;
///     }
/// }
///
/// zenav_protocol::settings! {
///     /// Planner.
///     pub struct Planning {
///         /// Expansions after which a search gives up.
///         pub max_expansions: usize = 1_000_000, "", 1..;
///         /// Distance from obstacles.
///         pub clearance: Clearance;
///     }
/// }
///
/// let mut planning = Planning::default();
/// assert_eq!(planning.clearance.weight, 2.0);
/// planning.clearance.weight = 11.0;
/// assert_eq!(
///     planning.check().unwrap_err().to_string(),
///     "`clearance.weight` is 11: expected 0 to 10 1/m"
/// );
/// let keys: Vec<String> = Planning::rows().into_iter().map(|row| row.key).collect();
/// assert_eq!(keys, ["max_expansions", "clearance.weight", "clearance.strict"]);
/// ```
#[macro_export]
macro_rules! settings {
    (@default) => { ::core::default::Default::default() };
    (@default $default:expr) => { $default };

    (@rows $rows:ident, $field:ident, $kind:ty, $doc:expr,) => {
        $rows.extend(<$kind as $crate::settings::Settings>::rows().into_iter().map(|row| row.within(stringify!($field))));
    };
    (@rows $rows:ident, $field:ident, $kind:ty, $doc:expr, $default:expr $(, $unit:literal $(, $bounds:expr)?)?) => {
        let default: $kind = $default;
        let row = $crate::settings::Row::new(stringify!($field), stringify!($kind), &default, $doc);
        $( let row = row.unit($unit); $( let row = row.bounds::<$kind>(&$bounds); )? )?
        $rows.push(row);
    };

    (@check $value:expr, $field:ident,) => {
        $crate::settings::Settings::check($value).map_err(|error| error.within(stringify!($field)))?;
    };
    (@check $value:expr, $field:ident, $default:expr, $unit:literal, $bounds:expr) => {
        $crate::settings::check(stringify!($field), *$value, $unit, &$bounds)?;
    };
    (@check $value:expr, $field:ident, $default:expr $(, $unit:literal)?) => {};

    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident {
            $(
                $(#[doc = $doc:literal])*
                $(#[serde $serde:tt])*
                $field_vis:vis $field:ident : $kind:ty $(= $default:expr $(, $unit:literal $(, $bounds:expr)?)?)? ;
            )*
        }
        $(check = $check:expr;)?
    ) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq, $crate::settings::serde::Serialize, $crate::settings::serde::Deserialize)]
        #[serde(crate = "zenav_protocol::settings::serde", deny_unknown_fields, default)]
        $vis struct $name {
            $( $(#[doc = $doc])* $(#[serde $serde])* $field_vis $field: $kind, )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $field: $crate::settings!(@default $($default)?), )* }
            }
        }

        impl $crate::settings::Settings for $name {
            fn rows() -> Vec<$crate::settings::Row> {
                let mut rows = Vec::new();
                $( $crate::settings!(@rows rows, $field, $kind, concat!($($doc),*), $($default $(, $unit $(, $bounds)?)?)?); )*
                rows
            }

            fn check(&self) -> Result<(), $crate::config_text::OutOfBounds> {
                $( $crate::settings!(@check &self.$field, $field, $($default $(, $unit $(, $bounds)?)?)?); )*
                $( ($check)(self)?; )?
                Ok(())
            }
        }
    };
}

/// A section of settings, as [`settings!`](crate::settings!) declares it.
pub trait Settings: Clone + Default + Serialize + DeserializeOwned {
    /// All settings, in the order of the declaration; keys of nested sections are joined by dots.
    fn rows() -> Vec<Row>;

    /// Whether every value is within its bounds and consistent with the others.
    ///
    /// # Errors
    /// The first value that is not, by its key.
    fn check(&self) -> Result<(), OutOfBounds>;

    /// Keys of all numeric settings.
    #[must_use]
    fn numbers() -> Vec<String> {
        let rows = Self::rows().into_iter().filter(|row| row.default.is_number());
        rows.map(|row| row.key).collect()
    }

    /// The numeric setting with this key.
    #[must_use]
    fn number(&self, key: &str) -> Option<f64> {
        let values = serde_json::to_value(self).ok()?;
        values.pointer(&pointer(key))?.as_f64()
    }

    /// A copy with one number changed; `None` if no numeric setting has this key.
    ///
    /// ```
    /// use zenav_protocol::{robot::ControllerGains, settings::Settings};
    ///
    /// let gains = ControllerGains::default();
    /// assert_eq!(gains.with_number("guard_margin", 0.1).unwrap()?.guard_margin, 0.1);
    /// let refused = gains.with_number("guard_margin", 2.0).unwrap().unwrap_err();
    /// assert_eq!(refused.to_string(), "`guard_margin` is 2: expected 0.01 to 0.5 m");
    /// assert!(gains.with_number("tracker", 1.0).is_none(), "a name, not a number");
    /// # Ok::<(), zenav_protocol::config_text::OutOfBounds>(())
    /// ```
    ///
    /// # Errors
    /// The value is out of bounds, not a whole number where one is needed, or inconsistent with the other settings.
    fn with_number(&self, key: &str, value: f64) -> Option<Result<Self, OutOfBounds>> {
        let row = Self::rows()
            .into_iter()
            .find(|row| row.key == key && row.default.is_number())?;
        if let Some(bounds) = row.bounds.as_ref().filter(|bounds| !bounds.contain(value)) {
            return Some(Err(OutOfBounds::outside(key, value, bounds, row.unit)));
        }
        let whole = !row.default.is_f64();
        if !value.is_finite() || (whole && value.fract() != 0.0) {
            let expected = if whole { "a whole number" } else { "a number" };
            return Some(Err(OutOfBounds::unlike(key, value, expected)));
        }
        let mut values = serde_json::to_value(self).ok()?;
        *values.pointer_mut(&pointer(key))? = if whole { (value as i64).into() } else { value.into() };
        let changed: Self = serde_json::from_value(values).ok()?;
        Some(changed.check().map(|()| changed))
    }
}

fn pointer(key: &str) -> String {
    format!("/{}", key.replace('.', "/"))
}

/// One setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Key, joined by dots with the enclosing sections.
    pub key: String,
    /// Rust type of the value.
    pub kind: &'static str,
    /// Default value.
    pub default: serde_json::Value,
    /// Unit of the value; empty without one.
    pub unit: &'static str,
    /// Bounds of the value; `None` if the whole range of its type is allowed.
    pub bounds: Option<Bounds>,
    /// Effect of the setting, and where the default comes from.
    pub doc: &'static str,
}

impl Row {
    #[doc(hidden)]
    #[must_use]
    pub fn new(key: &str, kind: &'static str, default: &impl Serialize, doc: &'static str) -> Self {
        Self {
            key: key.to_owned(),
            kind,
            default: serde_json::to_value(default).unwrap_or_default(),
            unit: "",
            bounds: None,
            doc: doc.trim(),
        }
    }

    #[doc(hidden)]
    #[must_use]
    pub fn unit(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    #[doc(hidden)]
    #[must_use]
    pub fn bounds<T: Bounded>(self, bounds: &impl RangeBounds<T>) -> Self {
        Self {
            bounds: Some(Bounds::of(bounds)),
            ..self
        }
    }

    /// The row as seen from the enclosing section.
    #[must_use]
    pub fn within(self, section: &str) -> Self {
        Self {
            key: format!("{section}.{}", self.key),
            ..self
        }
    }
}

/// Least and greatest value of a setting, if bounded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bounds {
    /// Least value.
    pub least: Option<f64>,
    /// Greatest value.
    pub most: Option<f64>,
}

impl Bounds {
    /// The bounds of a range, both ends included.
    #[must_use]
    pub fn of<T: Bounded>(range: &impl RangeBounds<T>) -> Self {
        let number = |bound| match bound {
            Bound::Included(end) | Bound::Excluded(end) => Some(T::number(end)),
            Bound::Unbounded => None,
        };
        Self {
            least: number(range.start_bound().cloned()),
            most: number(range.end_bound().cloned()),
        }
    }

    /// Whether a value is within the bounds; NaN never is.
    #[must_use]
    pub fn contain(&self, value: f64) -> bool {
        !value.is_nan() && self.least.is_none_or(|least| value >= least) && self.most.is_none_or(|most| value <= most)
    }
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.least, self.most) {
            (Some(least), Some(most)) => write!(f, "{} to {}", Number(least), Number(most)),
            (Some(least), None) => write!(f, "at least {}", Number(least)),
            (None, Some(most)) => write!(f, "at most {}", Number(most)),
            (None, None) => write!(f, "a number"),
        }
    }
}

/// A numeric type of settings.
pub trait Bounded: Copy {
    /// The value as `f64`.
    fn number(self) -> f64;
}

macro_rules! bounded {
    ($($kind:ty)*) => { $( impl Bounded for $kind { fn number(self) -> f64 { self as f64 } } )* };
}
bounded!(f64 f32 usize u64 u32 u16 u8 isize i64 i32 i16 i8);

/// Whether a value is within the bounds of its setting.
///
/// # Errors
/// When it is not.
#[doc(hidden)]
pub fn check<T: Bounded>(key: &str, value: T, unit: &str, bounds: &impl RangeBounds<T>) -> Result<(), OutOfBounds> {
    let (value, bounds) = (value.number(), Bounds::of(bounds));
    if bounds.contain(value) {
        Ok(())
    } else {
        Err(OutOfBounds::outside(key, value, &bounds, unit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Clone, Copy, Debug, PartialEq, Serialize, serde::Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Colour {
        DarkRed,
        Blue,
    }

    crate::settings! {
        /// A part of a car.
        struct Wheel {
            /// Its radius
            /// (as sold).
            radius: f64 = 0.1, "m", 0.01..=1.0;
            /// How many bolts hold it.
            bolts: u8 = 5, "", 3..=6;
            /// What it looks like.
            colour: Colour = Colour::Blue;
        }
        check = |wheel: &Wheel| match wheel.bolts {
            4 => Err(OutOfBounds::unlike("bolts", 4.0, "no even number")),
            _ => Ok(()),
        };
    }

    crate::settings! {
        /// A car.
        #[derive(Copy)]
        struct Seat {
            /// How warm.
            warmth: f64 = 0.0, "K";
        }
    }

    crate::settings! {
        /// A car.
        struct Car {
            /// Its maker.
            maker: String = "nobody".to_owned();
            /// How long it may wait.
            patience: f64 = 1.0, "s", 0.0..;
            /// In front.
            front: Wheel;
            /// To sit on.
            seat: Seat;
        }
    }

    #[test]
    fn a_section_reads_what_is_written_and_keeps_its_defaults_for_the_rest() {
        let car: Car = toml::from_str("patience = 3\n[front]\nradius = 0.2\ncolour = \"dark_red\"").unwrap();
        assert_eq!((car.patience, car.front.radius, car.front.bolts), (3.0, 0.2, 5));
        assert_eq!(
            (car.front.colour, car.maker.as_str(), car.seat),
            (Colour::DarkRed, "nobody", Seat::default())
        );
        let error = toml::from_str::<Car>("[front]\nradios = 0.2").unwrap_err().to_string();
        assert!(error.contains("radios") && error.contains("radius"), "{error}");
    }

    #[test]
    fn each_row_tells_key_type_default_unit_bounds_and_doc() {
        let rows = Car::rows();
        let keys: Vec<&str> = rows.iter().map(|row| row.key.as_str()).collect();
        assert_eq!(
            keys,
            [
                "maker",
                "patience",
                "front.radius",
                "front.bolts",
                "front.colour",
                "seat.warmth"
            ]
        );
        let radius = &rows[2];
        assert_eq!(
            (radius.kind, radius.unit, radius.doc),
            ("f64", "m", "Its radius (as sold).")
        );
        assert_eq!(
            (&radius.default, radius.bounds.unwrap().to_string()),
            (&0.1.into(), "0.01 to 1".into())
        );
        assert_eq!((&rows[4].default, rows[4].bounds), (&"blue".into(), None));
        assert_eq!(rows[1].bounds.unwrap().to_string(), "at least 0");
    }

    #[test]
    fn a_value_out_of_bounds_is_refused_by_key_value_range_and_unit() {
        let mut car = Car::default();
        car.check().unwrap();
        car.front.radius = f64::NAN;
        assert_eq!(
            car.check().unwrap_err().to_string(),
            "`front.radius` is NaN: expected 0.01 to 1 m"
        );
        car.front.radius = 0.3;
        car.front.bolts = 4;
        assert_eq!(
            car.check().unwrap_err().to_string(),
            "`front.bolts` is 4: expected no even number"
        );
    }

    #[test]
    fn a_number_is_read_and_set_by_its_key() {
        let car = Car::default();
        assert_eq!(
            Car::numbers(),
            ["patience", "front.radius", "front.bolts", "seat.warmth"]
        );
        for key in Car::numbers() {
            let value = car.number(&key).unwrap();
            assert_eq!(car.with_number(&key, value).unwrap().unwrap(), car, "{key}");
        }
        assert_eq!(car.with_number("front.bolts", 3.0).unwrap().unwrap().front.bolts, 3);
        let refused = |key, value| car.with_number(key, value).unwrap().unwrap_err().to_string();
        assert_eq!(
            refused("front.bolts", 3.5),
            "`front.bolts` is 3.5: expected a whole number"
        );
        assert_eq!(
            refused("front.bolts", 4.0),
            "`front.bolts` is 4: expected no even number"
        );
        assert_eq!(
            refused("front.radius", 2.0),
            "`front.radius` is 2: expected 0.01 to 1 m"
        );
        assert_eq!(
            refused("seat.warmth", f64::INFINITY),
            "`seat.warmth` is inf: expected a number"
        );
        assert!(car.with_number("front.colour", 1.0).is_none() && car.number("radius").is_none());
    }
}
