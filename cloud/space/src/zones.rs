//! Zones. Keep-out zones and speed limits: polygons in the map frame, drawn in a TOML file.
//!
//! ```toml
//! [[keep_out]]                 # no part of a robot enters
//! name = "stairs"              # optional
//! points = [[1.0, 0.0], [2.0, 0.0], [2.0, 1.5]]
//! [[speed_limit]]              # while the robot's centre is inside
//! points = [[4.0, 0.0], [6.0, 0.0], [6.0, 3.0], [4.0, 3.0]]
//! max_speed = 0.3              # m/s
//! ```

use std::ops::RangeInclusive;

use nalgebra::Point2;
use serde::Deserialize;
use thiserror::Error;
use toml::Spanned;
use zenav_protocol::config_text::{Number, Pair, Source, TextError};
use zenav_protocol::geometry::MAX_COORDINATE;
use zenav_protocol::grid::GridSpec;
use zenav_protocol::messages::{Zone, ZoneRule};
use zenav_protocol::polygon::{contains, simple};

use super::raster::CellMask;

/// Largest number of zones of a kind.
const MAX_ZONES: usize = 1000;
/// Largest number of corners of a zone.
const MAX_CORNERS: usize = 1000;
/// Speed limits of zones, m/s. At less than the first, a robot that is inside hardly gets out.
const SPEEDS: RangeInclusive<f64> = 0.01..=100.0;

/// Why zones received over the network were refused.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("zone `{zone}`: {problem}")]
pub struct ZoneError {
    /// Name of the zone.
    pub zone: String,
    /// What is wrong with it, and what was expected.
    pub problem: String,
}

/// An area of the map frame.
#[derive(Clone, Debug, PartialEq)]
struct Area {
    /// Its name, for people.
    name: Option<String>,
    /// A simple polygon, m.
    corners: Vec<Point2<f64>>,
    low: Point2<f64>,
    high: Point2<f64>,
}

impl Area {
    /// A simple polygon of these corners; the error says what is wrong with them.
    fn new(name: Option<String>, points: &[[f64; 2]]) -> Result<Self, String> {
        let count = points.len();
        if !(3..=MAX_CORNERS).contains(&count) {
            return Err(format!("{count} points: expected 3 to {MAX_CORNERS}"));
        }
        let outside = |value: &&f64| !(value.is_finite() && value.abs() <= MAX_COORDINATE);
        if let Some(value) = points.iter().flatten().find(outside) {
            return Err(format!(
                "{}: expected a number within {MAX_COORDINATE}, m",
                Number(*value)
            ));
        }
        let corners: Vec<Point2<f64>> = points.iter().copied().map(Point2::from).collect();
        let corners = simple(corners).map_err(|error| error.to_string())?;
        let mut area = Self {
            name,
            low: corners[0],
            high: corners[0],
            corners,
        };
        for corner in &area.corners {
            (area.low, area.high) = (area.low.inf(corner), area.high.sup(corner));
        }
        Ok(area)
    }

    fn contains(&self, point: Point2<f64>) -> bool {
        let within = point >= self.low && point <= self.high;
        within && contains(&self.corners, point)
    }
}

/// Keep-out zones and speed zones; none by default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Zones {
    keep_out: Vec<Area>,
    speed_limits: Vec<(Area, f64)>,
}

impl Zones {
    /// Reads a file of zones; `file` is for errors.
    ///
    /// # Errors
    /// [`TextError`] names the file, the line and the key.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_space::Zones;
    ///
    /// let text = "[[keep_out]]\nname = \"stairs\"\npoints = [[0, 0], [2, 0], [2, 1], [0, 1]]\n";
    /// let zones = Zones::from_toml(text, "zones.toml")?;
    /// assert_eq!(zones.keep_out(Point2::new(1.0, 0.5)), Some("stairs"));
    /// # Ok::<(), zenav_protocol::config_text::TextError>(())
    /// ```
    pub fn from_toml(text: &str, file: &str) -> Result<Self, TextError> {
        let source = Source { text, file };
        let zones: ZonesFile = source.toml()?;
        for (count, key) in [
            (zones.keep_out.len(), "keep_out"),
            (zones.speed_limit.len(), "speed_limit"),
        ] {
            if count > MAX_ZONES {
                return Err(source.refused(0, key, format!("{count} zones: expected at most {MAX_ZONES}")));
            }
        }
        let keep_out = zones
            .keep_out
            .into_iter()
            .map(|zone| area(source, zone.name, &zone.points, "keep_out.points"))
            .collect::<Result<_, _>>()?;
        let speed_limits = zones
            .speed_limit
            .into_iter()
            .map(|zone| {
                let speed = *zone.max_speed.get_ref();
                check_speed(speed)
                    .map_err(|problem| source.refused(zone.max_speed.span().start, "speed_limit.max_speed", problem))?;
                Ok((area(source, zone.name, &zone.points, "speed_limit.points")?, speed))
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { keep_out, speed_limits })
    }

    /// The zones of a message, with the checks of a file.
    ///
    /// # Errors
    /// [`ZoneError`] names the first invalid zone.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::messages::{Zone, ZoneRule};
    /// use zenav_space::Zones;
    ///
    /// let points = vec![Point2::new(0.0, 0.0), Point2::new(2.0, 0.0), Point2::new(0.0, 1.0)];
    /// let zone = Zone { name: "door".into(), rule: ZoneRule::SpeedLimit { max_speed: 0.3 }, points };
    /// assert_eq!(Zones::new(&[zone])?.speed_limit(Point2::new(0.5, 0.5)), Some(0.3));
    /// # Ok::<(), zenav_space::ZoneError>(())
    /// ```
    pub fn new(zones: &[Zone]) -> Result<Self, ZoneError> {
        let mut all = Self::default();
        for zone in zones {
            let fail = |problem| ZoneError {
                zone: zone.name.chars().take(80).collect(),
                problem,
            };
            let points: Vec<[f64; 2]> = zone.points.iter().map(|point| [point.x, point.y]).collect();
            let area = Area::new(Some(zone.name.clone()), &points).map_err(fail)?;
            match zone.rule {
                ZoneRule::KeepOut => all.keep_out.push(area),
                ZoneRule::SpeedLimit { max_speed } => {
                    check_speed(max_speed).map_err(fail)?;
                    all.speed_limits.push((area, max_speed));
                }
            }
            let most = all.keep_out.len().max(all.speed_limits.len());
            if most > MAX_ZONES {
                return Err(fail(format!("one more than the {MAX_ZONES} of its kind that may be")));
            }
        }
        Ok(all)
    }

    /// The zones as messages; a zone without a name is named after its position in the file.
    #[must_use]
    pub fn to_messages(&self) -> Vec<Zone> {
        let zone = |(at, area, rule, kind): (usize, &Area, ZoneRule, &str)| Zone {
            name: area.name.clone().unwrap_or_else(|| format!("{kind}_{}", at + 1)),
            rule,
            points: area.corners.clone(),
        };
        let keep_out = self.keep_out.iter().enumerate();
        let slow = self.speed_limits.iter().enumerate();
        keep_out
            .map(|(at, area)| (at, area, ZoneRule::KeepOut, "keep_out"))
            .chain(slow.map(|(at, (area, speed))| {
                let rule = ZoneRule::SpeedLimit { max_speed: *speed };
                (at, area, rule, "speed_limit")
            }))
            .map(zone)
            .collect()
    }

    /// Whether there is any speed zone.
    #[must_use]
    pub fn has_speed_limits(&self) -> bool {
        !self.speed_limits.is_empty()
    }

    /// Speed limit of a robot whose centre is at a point, m/s; `None` outside all speed zones. Where zones overlap, the lowest.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_space::Zones;
    ///
    /// let text = "[[speed_limit]]\npoints = [[0, 0], [4, 0], [4, 4], [0, 4]]\nmax_speed = 0.5
    /// [[speed_limit]]\npoints = [[0, 0], [1, 0], [1, 1], [0, 1]]\nmax_speed = 0.2";
    /// let zones = Zones::from_toml(text, "zones.toml")?;
    /// let limits = [0.5, 2.0, 5.0].map(|x| zones.speed_limit(Point2::new(x, 0.5)));
    /// assert_eq!(limits, [Some(0.2), Some(0.5), None]);
    /// # Ok::<(), zenav_protocol::config_text::TextError>(())
    /// ```
    #[must_use]
    pub fn speed_limit(&self, point: Point2<f64>) -> Option<f64> {
        let here = self.speed_limits.iter().filter(|(area, _)| area.contains(point));
        here.map(|(_, speed)| *speed).reduce(f64::min)
    }

    /// Name of the keep-out zone that contains a point, or `keep-out zone` if it has no name.
    #[must_use]
    pub fn keep_out(&self, point: Point2<f64>) -> Option<&str> {
        let here = self.keep_out.iter().find(|area| area.contains(point))?;
        Some(here.name.as_deref().unwrap_or("keep-out zone"))
    }

    /// The cells of a grid that a keep-out zone touches; `None` if there are none.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_protocol::grid::{Cell, GridSpec};
    /// use zenav_space::Zones;
    ///
    /// let text = "[[keep_out]]\npoints = [[1.05, 1.05], [1.15, 1.05], [1.15, 1.15], [1.05, 1.15]]";
    /// let spec = GridSpec { origin: Point2::origin(), resolution: 0.1, width: 40, height: 40 };
    /// let cells = Zones::from_toml(text, "zones.toml")?.keep_out_cells(&spec).unwrap();
    /// assert!(cells.is_set(Cell::new(10, 11)) && !cells.is_set(Cell::new(12, 11)));
    /// # Ok::<(), zenav_protocol::config_text::TextError>(())
    /// ```
    #[must_use]
    pub fn keep_out_cells(&self, spec: &GridSpec) -> Option<CellMask> {
        CellMask::of(self.keep_out.iter().map(|area| area.corners.as_slice()), spec)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ZonesFile {
    #[serde(default)]
    keep_out: Vec<KeepOutTable>,
    #[serde(default)]
    speed_limit: Vec<SpeedLimitTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KeepOutTable {
    name: Option<String>,
    points: Spanned<Vec<Pair>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SpeedLimitTable {
    name: Option<String>,
    points: Spanned<Vec<Pair>>,
    max_speed: Spanned<f64>,
}

fn area(
    source: Source<'_>,
    name: Option<String>,
    points: &Spanned<Vec<Pair>>,
    key: &'static str,
) -> Result<Area, TextError> {
    let corners: Vec<[f64; 2]> = points.get_ref().iter().map(|Pair(point)| *point).collect();
    Area::new(name, &corners).map_err(|problem| source.refused(points.span().start, key, problem))
}

/// Checks a zone's speed; the error says what is wrong.
fn check_speed(speed: f64) -> Result<(), String> {
    if SPEEDS.contains(&speed) {
        Ok(())
    } else {
        Err(format!(
            "{}: expected {} to {} m/s; what may not be entered is a keep-out zone",
            Number(speed),
            SPEEDS.start(),
            SPEEDS.end()
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ZONES: &str = r#"
[[keep_out]]
name = "stairs"
points = [[1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0]]
[[keep_out]]
points = [[-1.0, 0.0], [-2.0, 1.0], [-2.0, 0.0]]
[[speed_limit]]
points = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]
max_speed = 0.5
[[speed_limit]]
name = "door"
points = [[3.0, 3.0], [5.0, 3.0], [5.0, 5.0], [3.0, 5.0]]
max_speed = 0.2
"#;

    #[test]
    fn a_point_knows_its_zones() {
        let zones = Zones::from_toml(ZONES, "z.toml").unwrap();
        let limit = |x, y| zones.speed_limit(Point2::new(x, y));
        assert_eq!(
            (limit(1.0, 1.0), limit(3.5, 3.5), limit(4.5, 4.5), limit(4.5, 1.0)),
            (Some(0.5), Some(0.2), Some(0.2), None)
        );
        assert_eq!(limit(f64::NAN, 1.0), None);
        let out = |x, y| zones.keep_out(Point2::new(x, y));
        assert_eq!(
            (out(1.5, 0.5), out(-1.9, 0.5), out(0.0, 0.5)),
            (Some("stairs"), Some("keep-out zone"), None)
        );
        let none = Zones::from_toml("", "z.toml").unwrap();
        assert_eq!(none, Zones::default());
    }

    #[test]
    fn zones_of_a_file_are_the_same_as_a_message_and_wrong_ones_are_named() {
        let of_file = Zones::from_toml(ZONES, "z.toml").unwrap();
        let mut messages = of_file.to_messages();
        let names: Vec<&str> = messages.iter().map(|zone| zone.name.as_str()).collect();
        assert_eq!(names, ["stairs", "keep_out_2", "speed_limit_1", "door"]);
        let again = Zones::new(&messages).unwrap();
        assert_eq!(again.to_messages(), messages);
        assert_eq!(again.speed_limit(Point2::new(4.5, 4.5)), Some(0.2));
        messages[3].rule = ZoneRule::SpeedLimit { max_speed: 1e-9 };
        assert!(Zones::new(&messages).is_err(), "a robot would stay inside for years");
        messages[3].rule = ZoneRule::SpeedLimit { max_speed: 0.0 };
        let error = Zones::new(&messages).unwrap_err().to_string();
        assert!(error.contains("zone `door`: 0: expected 0.01 to 100 m/s"), "{error}");
        messages[0].points.truncate(2);
        let error = Zones::new(&messages).unwrap_err().to_string();
        assert!(error.contains("zone `stairs`: 2 points: expected 3"), "{error}");
    }

    #[test]
    fn what_is_wrong_is_named_with_file_line_and_key() {
        let square = "points = [[0, 0], [1, 0], [1, 1], [0, 1]]";
        let wrong = [
            (format!("\n[[keep_out]]\n{square}\nspeed = 1\n"), "z.toml:4:", "speed"),
            ("[[keep_out]]\n".to_owned(), "z.toml:1:", "points"),
            (
                "[[keep_out]]\npoints = [[0, 0], [1, 1]]\n".to_owned(),
                "z.toml:2:",
                "`keep_out.points`: 2 points: expected 3",
            ),
            (
                "[[keep_out]]\n\npoints = [[0, 0], [1, 1], [1, 0], [0, 1]]\n".to_owned(),
                "z.toml:3:",
                "meets itself",
            ),
            (
                "[[keep_out]]\npoints = [[0, 0], [1, 1], [2, 2]]\n".to_owned(),
                "z.toml:2:",
                "turns straight back",
            ),
            (
                "[[keep_out]]\npoints = [[0, 0], [nan, 1], [2, 2]]\n".to_owned(),
                "z.toml:2:",
                "NaN",
            ),
            (format!("[[speed_limit]]\n{square}\n"), "z.toml:1:", "max_speed"),
            (
                format!("[[speed_limit]]\n{square}\nmax_speed = 0\n"),
                "z.toml:3:",
                "expected 0.01 to 100 m/s",
            ),
            (
                format!("[[speed_limit]]\n{square}\nmax_speed = inf\n"),
                "z.toml:3:",
                "expected 0.01 to 100 m/s",
            ),
            ("keep_out = 3\n".to_owned(), "z.toml:1:", "keep_out"),
        ];
        for (text, place, what) in wrong {
            let error = Zones::from_toml(&text, "z.toml").unwrap_err().to_string();
            assert!(error.starts_with(place) && error.contains(what), "{text}: {error}");
        }
    }
}
