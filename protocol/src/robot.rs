//! Robot model. What are the footprint, limits and sensors of a robot, for planning, driving and simulation?
//!
//! Read from TOML; unknown keys are errors that name the line. Shipped robots are found by name, and options such as `rear_lidar` are
//! appended with `+`: `jackal+rear_lidar`.

use std::collections::BTreeMap;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use crate::config_text::{OutOfBounds, Pair};
pub use crate::drive::{Drive, DriveErrors, DriveKind};
use crate::energy::MotorModel;
pub use crate::gains::ControllerGains;
use crate::polygon::{self, Edge};
pub use crate::robot_check::RobotError;
use crate::sensors::DEFAULT_LIDAR;
pub use crate::sensors::{BatteryModel, EncoderModel, GpsModel, ImuModel, LidarModel};
use crate::wall_following::WallFollowing;

macro_rules! robot_model {
    ([] $($(#[doc = $doc:literal])* $(#[serde $serde:tt])* $kind:ident: $Model:ident => $Reading:ident, $TOPIC:ident = $key:literal;)*) => {
        /// A robot, as described by its file.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        #[serde(deny_unknown_fields)]
        pub struct RobotModel {
            /// Name of the model.
            pub name: String,
            /// Outline on the floor.
            pub footprint: Footprint,
            /// Wheels and motors.
            pub drive: Drive,
            /// The lidar named [`DEFAULT_LIDAR`].
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub lidar: Option<LidarModel>,
            /// Lidars by name: further ones, or all of them. [`Self::all_lidars`] lists them with [`Self::lidar`].
            #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
            pub lidars: BTreeMap<String, LidarModel>,
            /// Wheel encoders.
            #[serde(default)]
            pub encoders: EncoderModel,
            /// Gyro and compass.
            #[serde(default)]
            pub imu: ImuModel,
            $(
                $(#[doc = $doc])*
                #[serde(default)]
                $(#[serde $serde])*
                pub $kind: Option<$crate::sensors::$Model>,
            )*
            /// Battery.
            #[serde(default)]
            pub battery: BatteryModel,
            /// Motors, and the mass that they move.
            #[serde(default)]
            pub motors: MotorModel,
            /// Gains of the trackers.
            #[serde(default)]
            pub controller: ControllerGains,
            /// Distances, speeds and gains of the wall follower.
            #[serde(default)]
            pub wall_following: WallFollowing,
        }

        impl RobotModel {
            /// Names of the table's kinds.
            pub(crate) const KINDS: &[&str] = &[$(stringify!($kind)),*];

            /// Checks the sensors of the table's kinds; the first value out of bounds.
            pub(crate) fn check_kinds(&self) -> Result<(), OutOfBounds> {
                $(
                    let model = self.$kind.as_ref();
                    model.map_or(Ok(()), |model| model.check()).map_err(|error| error.within(stringify!($kind)))?;
                )*
                Ok(())
            }
        }
    };
}

crate::sensor_kinds!(robot_model []);

/// Outline on the floor, base frame.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::robot::Footprint;
///
/// // 0.5 m by 0.4 m; the axle is 0.1 m in front of the middle.
/// let corners = [(-0.35, -0.2), (0.15, -0.2), (0.15, 0.2), (-0.35, 0.2)];
/// let footprint = Footprint::Polygon(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
/// assert!((footprint.inscribed_radius() - 0.15).abs() < 1e-9);
/// assert!((footprint.circumscribed_radius() - 0.35_f64.hypot(0.2)).abs() < 1e-9);
/// assert!((footprint.distance(Point2::new(0.65, 0.0)) - 0.5).abs() < 1e-9);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(with = "FootprintTable"))]
#[serde(rename_all = "snake_case", try_from = "FootprintTable")]
pub enum Footprint {
    /// A disc around the base, m.
    Radius(f64),
    /// Corners of a convex polygon, counter-clockwise, m.
    Polygon(Vec<Point2<f64>>),
}

/// A footprint as written in the file: exactly one of the keys. The corners run either way round.
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
struct FootprintTable {
    radius: Option<f64>,
    #[cfg_attr(feature = "schema", schemars(with = "Option<Vec<[f64; 2]>>"))]
    polygon: Option<Vec<Pair>>,
}

impl TryFrom<FootprintTable> for Footprint {
    type Error = &'static str;

    fn try_from(table: FootprintTable) -> Result<Self, Self::Error> {
        match table {
            FootprintTable {
                radius: Some(radius),
                polygon: None,
            } => Ok(Self::Radius(radius)),
            FootprintTable {
                radius: None,
                polygon: Some(corners),
            } => {
                let mut corners: Vec<Point2<f64>> = corners.into_iter().map(Point2::from).collect();
                if polygon::doubled_area(&corners) < 0.0 {
                    corners.reverse();
                }
                Ok(Self::Polygon(corners))
            }
            FootprintTable { radius: Some(_), .. } => {
                Err("`footprint` has both `radius` and `polygon`: expected either of them")
            }
            _ => Err("`footprint`: expected either `radius` or `polygon`"),
        }
    }
}

impl Footprint {
    /// Radius of the largest disc around the base that fits inside the outline, m.
    #[must_use]
    pub fn inscribed_radius(&self) -> f64 {
        match self {
            Self::Radius(radius) => *radius,
            Self::Polygon(corners) => {
                let distance = |Edge { a, b }| polygon::cross(b - a, a.coords).abs() / (b - a).norm();
                polygon::edges(corners).map(distance).fold(f64::INFINITY, f64::min)
            }
        }
    }

    /// Radius of the smallest disc around the base that contains the outline, m.
    #[must_use]
    pub fn circumscribed_radius(&self) -> f64 {
        match self {
            Self::Radius(radius) => *radius,
            Self::Polygon(corners) => corners.iter().map(|corner| corner.coords.norm()).fold(0.0, f64::max),
        }
    }

    /// Half the width that a robot needs to drive straight ahead, m: the largest distance of the outline from the x axis of the base.
    #[must_use]
    pub fn half_width(&self) -> f64 {
        match self {
            Self::Radius(radius) => *radius,
            Self::Polygon(corners) => corners.iter().map(|corner| corner.y.abs()).fold(0.0, f64::max),
        }
    }

    /// The outline moved outwards by a distance on all sides, m; a negative distance moves it inwards, by at most half the inscribed
    /// radius.
    #[must_use]
    pub fn offset(&self, by: f64) -> Self {
        let by = by.max(-0.5 * self.inscribed_radius());
        match self {
            Self::Radius(radius) => Self::Radius(radius + by),
            Self::Polygon(corners) => Self::Polygon(polygon::offset(corners, by)),
        }
    }

    /// The outline of the same robot with rear and front exchanged.
    #[must_use]
    pub fn turned(&self) -> Self {
        match self {
            Self::Radius(radius) => Self::Radius(*radius),
            Self::Polygon(corners) => Self::Polygon(corners.iter().map(|corner| -*corner).collect()),
        }
    }

    /// Distance from the outline to a point in the base frame, m; zero inside. Edge by edge, 3.6 times as fast as by parry's GJK
    /// (`cargo bench -p zenav-edge --bench collision_monitor`).
    #[must_use]
    pub fn distance(&self, point: Point2<f64>) -> f64 {
        match self {
            Self::Radius(radius) => (point.coords.norm() - radius).max(0.0),
            Self::Polygon(corners) => {
                let mut inside = true;
                let mut nearest = f64::INFINITY;
                for Edge { a, b } in polygon::edges(corners) {
                    let (along, to) = (b - a, point - a);
                    inside &= polygon::cross(along, to) >= 0.0;
                    let share = (to.dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
                    nearest = nearest.min((to - along * share).norm());
                }
                if inside { 0.0 } else { nearest }
            }
        }
    }

    /// How deep a point in the base frame lies inside the outline, m; zero outside.
    #[must_use]
    pub fn depth(&self, point: Point2<f64>) -> f64 {
        match self {
            Self::Radius(radius) => (radius - point.coords.norm()).max(0.0),
            Self::Polygon(corners) => polygon::edges(corners)
                .map(|Edge { a, b }| (b - a).perp(&(point - a)) / (b - a).norm())
                .fold(f64::INFINITY, f64::min)
                .max(0.0),
        }
    }
}

/// Names and texts of the shipped options: partial files laid over a robot's file.
pub const OPTIONS: &[(&str, &str)] = &[
    ("rear_lidar", include_str!("../robots/options/rear_lidar.toml")),
    ("indoor", include_str!("../robots/options/indoor.toml")),
    ("worn", include_str!("../robots/options/worn.toml")),
];

/// Key of an option file: list of keys or dotted paths to remove from the robot.
const WITHOUT: &str = "without";

/// Names and texts of the shipped robots.
pub const SHIPPED: &[(&str, &str)] = &[
    ("tiago", include_str!("../robots/tiago.toml")),
    ("neato", include_str!("../robots/neato.toml")),
    ("turtlebot3_waffle", include_str!("../robots/turtlebot3_waffle.toml")),
    ("jackal", include_str!("../robots/jackal.toml")),
];

/// The text of a shipped robot.
#[must_use]
pub fn shipped(name: &str) -> Option<&'static str> {
    SHIPPED.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

impl RobotModel {
    /// Reads a robot file's text; `name` is used in errors.
    ///
    /// ```
    /// use zenav_protocol::robot::{RobotModel, shipped};
    ///
    /// let text = shipped("tiago").unwrap_or_default();
    /// let tiago = RobotModel::from_toml(text, "tiago.toml")?;
    /// assert!((tiago.drive.top_speed() - 0.619).abs() < 0.001, "m/s");
    /// let in_millimetres = text.replace("wheel_radius = 0.0985", "wheel_radius = 98.5");
    /// let error = RobotModel::from_toml(&in_millimetres, "tiago.toml").unwrap_err().to_string();
    /// assert!(error.starts_with("tiago.toml:8: `drive.wheel_radius` is 98.5"), "{error}");
    /// # Ok::<(), zenav_protocol::robot::RobotError>(())
    /// ```
    ///
    /// # Errors
    /// [`RobotError`] for text that is not TOML, unknown or missing keys, and values out of bounds: with file, line and key.
    pub fn from_toml(text: &str, name: &str) -> Result<Self, RobotError> {
        let refused = |source| RobotError::toml(name, source);
        let model: Self = toml::from_str(text).map_err(refused)?;
        let model = model.fitted(&text.parse::<toml::Table>().map_err(refused)?);
        model
            .check()
            .map_err(|error| RobotError::value(error, name, Some(text)))?;
        Ok(model)
    }

    /// Reads a robot and its options, `ROBOT+OPTION+…`: the tables of the option files are laid over those of the robot file, and the keys
    /// listed in an option's `without` are removed.
    ///
    /// `read` returns the text of a file that is not a shipped robot or option, or why it cannot be read.
    ///
    /// # Errors
    /// [`RobotError`], as for [`Self::from_toml`]; values that only the combination of files puts out of bounds are named without a line.
    ///
    /// ```
    /// use zenav_protocol::robot::RobotModel;
    ///
    /// let jackal = RobotModel::with_options("jackal+rear_lidar", |name| Err(format!("no such file: {name}")))?;
    /// let names: Vec<&str> = jackal.all_lidars().map(|(name, _)| name).collect();
    /// assert_eq!(names, ["lidar", "rear"]);
    /// # Ok::<(), zenav_protocol::robot::RobotError>(())
    /// ```
    pub fn with_options(names: &str, read: impl Fn(&str) -> Result<String, String>) -> Result<Self, RobotError> {
        let text_of = |name: &str, shipped: &[(&str, &str)]| match shipped.iter().find(|(known, _)| *known == name) {
            Some((_, text)) => Ok((*text).to_owned()),
            None => read(name).map_err(|reason| RobotError::Unknown {
                name: name.to_owned(),
                reason,
            }),
        };
        let mut parts = names.split('+');
        let robot = parts.next().unwrap_or_default();
        let text = text_of(robot, SHIPPED)?;
        // Read without options first, so that errors in the robot's own file name its lines.
        let alone = Self::from_toml(&text, robot)?;
        let mut options = parts.peekable();
        if options.peek().is_none() {
            return Ok(alone);
        }
        let table = |text: &str, name: &str| text.parse().map_err(|source| RobotError::toml(name, source));
        let mut sum: toml::Table = table(&text, robot)?;
        for option in options {
            let mut over = table(&text_of(option, OPTIONS)?, option)?;
            let without = over.remove(WITHOUT);
            lay_over(&mut sum, over);
            if let Some(keys) = without {
                take_away(&mut sum, keys).map_err(|problem| {
                    let error = OutOfBounds {
                        key: WITHOUT.to_owned(),
                        problem,
                    };
                    RobotError::value(error, option, None)
                })?;
            }
        }
        let model: Self = sum
            .clone()
            .try_into()
            .map_err(|source| RobotError::toml(names, source))?;
        model.fitted(&sum).checked(names)
    }

    /// Adapts the wall follower's distances to this robot where its `file` does not set them.
    fn fitted(self, file: &toml::Table) -> Self {
        let written = file.get("wall_following").and_then(toml::Value::as_table);
        let reach = self.footprint.circumscribed_radius();
        Self {
            wall_following: self
                .wall_following
                .fitted(reach, |key| written.is_some_and(|written| written.contains_key(key))),
            ..self
        }
    }

    /// Checks the values of a model from any source; `name` is used in errors.
    ///
    /// # Errors
    /// [`RobotError::Value`].
    pub fn checked(self, name: &str) -> Result<Self, RobotError> {
        self.check().map_err(|error| RobotError::value(error, name, None))?;
        Ok(self)
    }

    /// All lidars with their names: the one named [`DEFAULT_LIDAR`] first, then the others by name. The first is the main lidar
    /// ([`Self::is_main_lidar`]).
    pub fn all_lidars(&self) -> impl Iterator<Item = (&str, &LidarModel)> {
        let lidars = &self.lidars;
        let named = move |is_default: bool| {
            lidars
                .iter()
                .map(|(name, lidar)| (name.as_str(), lidar))
                .filter(move |(name, _)| (*name == DEFAULT_LIDAR) == is_default)
        };
        let unnamed = self.lidar.as_ref().map(|lidar| (DEFAULT_LIDAR, lidar));
        unnamed.into_iter().chain(named(true)).chain(named(false))
    }

    /// As [`Self::all_lidars`], mutable.
    pub fn all_lidars_mut(&mut self) -> impl Iterator<Item = (&str, &mut LidarModel)> {
        let named = self.lidars.iter_mut().map(|(name, lidar)| (name.as_str(), lidar));
        let (default, others): (Vec<_>, Vec<_>) = named.partition(|(name, _)| *name == DEFAULT_LIDAR);
        let unnamed = self.lidar.as_mut().map(|lidar| (DEFAULT_LIDAR, lidar));
        unnamed.into_iter().chain(default).chain(others)
    }

    /// Whether the lidar of this name is the main one: the first of [`Self::all_lidars`], whatever its name. Its scans are published on the
    /// plain scan key, and SLAM and localisation get the robot's pose from them alone; scans of further lidars are drawn at that pose.
    #[must_use]
    pub fn is_main_lidar(&self, name: &str) -> bool {
        self.all_lidars().next().is_some_and(|(main, _)| main == name)
    }

    /// The first lidar; every robot read from a file has one.
    #[must_use]
    pub fn first_lidar(&self) -> Option<&LidarModel> {
        self.all_lidars().next().map(|(_, lidar)| lidar)
    }
}

/// Merges tables recursively; any other value replaces the previous one.
fn lay_over(table: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(table)), toml::Value::Table(over)) => lay_over(table, over),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

/// Removes keys from a table; missing keys are ignored.
fn take_away(table: &mut toml::Table, keys: toml::Value) -> Result<(), String> {
    let keys: Vec<String> = keys
        .try_into()
        .map_err(|_| "expected a list of keys, as in [\"gps\", \"imu.compass_noise\"]".to_owned())?;
    for key in keys {
        let (path, last) = key.rsplit_once('.').unwrap_or(("", &key));
        let inner = path
            .split('.')
            .filter(|name| !name.is_empty())
            .try_fold(&mut *table, |table, name| {
                table.get_mut(name).and_then(toml::Value::as_table_mut)
            });
        if let Some(inner) = inner {
            inner.remove(last);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_option_may_take_sensors_away() {
        let nothing = |name: &str| Err(format!("no such file: {name}"));
        for (robot, _) in SHIPPED {
            let model = RobotModel::with_options(&format!("{robot}+indoor"), nothing).unwrap();
            assert!(model.gps.is_none() && model.imu.compass_noise.is_none(), "{robot}");
        }
        let refused = RobotModel::with_options("tiago+bad", |_| Ok("without = \"gps\"".to_owned())).unwrap_err();
        assert!(refused.to_string().contains("expected a list of keys"), "{refused}");
    }

    #[test]
    fn a_large_robot_keeps_its_distance_from_walls_without_being_told_to() {
        let nothing = |name: &str| Err(format!("no such file: {name}"));
        for (half_length, half_width) in [(0.6, 0.4), (1.0, 0.5)] {
            let corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
                .map(|(x, y)| [f64::from(x) * half_length, f64::from(y) * half_width]);
            let text = shipped("tiago")
                .unwrap()
                .replace("radius = 0.265", &format!("polygon = {corners:?}"));
            let model = RobotModel::from_toml(&text, "agv.toml").unwrap();
            assert!(model.wall_following.target_distance > model.footprint.circumscribed_radius() + 0.1);
            let read = |name: &str| {
                if name == "agv.toml" {
                    Ok(text.clone())
                } else {
                    nothing(name)
                }
            };
            let indoors = RobotModel::with_options("agv.toml+indoor", read).unwrap();
            assert_eq!(indoors.wall_following, model.wall_following);
        }
    }

    #[test]
    fn every_shipped_robot_can_be_read() {
        for (name, text) in SHIPPED {
            let model = RobotModel::from_toml(text, name).unwrap();
            assert_eq!(model.name, *name);
        }
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line() {
        let text = format!("speed = 3\n{}", shipped("tiago").unwrap());
        let error = RobotModel::from_toml(&text, "my.toml").unwrap_err().to_string();
        assert!(
            error.contains("my.toml") && error.contains("line 1") && error.contains("speed"),
            "{error}"
        );
    }

    #[test]
    fn a_rectangle_knows_its_distances() {
        let jackal = RobotModel::from_toml(shipped("jackal").unwrap(), "jackal")
            .unwrap()
            .footprint;
        assert!((jackal.inscribed_radius() - 0.165).abs() < 1e-12);
        assert!((jackal.circumscribed_radius() - 0.21_f64.hypot(0.165)).abs() < 1e-12);
        assert!((jackal.half_width() - 0.165).abs() < 1e-12);
        let corners = [(-0.3, -0.1), (0.3, -0.1), (0.3, 0.4), (-0.3, 0.4)].map(|(x, y)| Point2::new(x, y));
        assert!((Footprint::Polygon(corners.to_vec()).half_width() - 0.4).abs() < 1e-12);
        assert!((jackal.distance(Point2::new(0.31, 0.0)) - 0.1).abs() < 1e-12);
        assert_eq!(jackal.distance(Point2::new(0.1, 0.1)), 0.0);
    }

    #[test]
    fn the_corners_of_a_footprint_run_either_way_round() {
        let (left, right) = (
            "[[0.2, -0.15], [0.2, 0.15], [-0.2, 0]]",
            "[[-0.2, 0], [0.2, 0.15], [0.2, -0.15]]",
        );
        let model = |corners: &str| {
            let text = shipped("tiago")
                .unwrap()
                .replace("radius = 0.265", &format!("polygon = {corners}"));
            RobotModel::from_toml(&text, "mine").unwrap().footprint
        };
        assert_eq!(model(right), model(left));
        assert!(matches!(model(right), Footprint::Polygon(corners) if polygon::is_convex(&corners)));
    }

    #[test]
    fn a_robot_has_any_number_of_lidars_by_name() {
        let names = |model: &RobotModel| model.all_lidars().map(|(name, _)| name.to_owned()).collect::<Vec<_>>();
        let nothing = |name: &str| Err(format!("{name}?"));
        for robot in ["jackal", "tiago"] {
            let model = RobotModel::with_options(&format!("{robot}+rear_lidar"), nothing).unwrap();
            assert_eq!(names(&model), ["lidar", "rear"]);
            assert_eq!(model.lidars["rear"].mount.x, -0.15);
            let alone = RobotModel::with_options(robot, nothing).unwrap();
            assert_eq!((names(&alone), &alone.lidar), (vec!["lidar".to_owned()], &model.lidar));
        }
        let text = shipped("tiago").unwrap().replace("[lidar]", "[lidars.front]");
        let front = RobotModel::from_toml(&text, "front").unwrap();
        assert_eq!(
            (names(&front), front.first_lidar()),
            (vec!["front".to_owned()], front.lidars.get("front"))
        );
    }

    #[test]
    fn the_main_lidar_is_the_one_named_lidar_and_without_it_the_first_by_name() {
        let tiago = shipped("tiago").unwrap();
        let rear = OPTIONS.iter().find(|(name, _)| *name == "rear_lidar").unwrap().1;
        for (first, second, expected) in [
            ("[lidar]", "[lidars.front]", "lidar"),
            ("[lidars.lidar]", "[lidars.front]", "lidar"),
            ("[lidars.front]", "[lidars.rear]", "front"),
            ("[lidars.rear]", "[lidars.front]", "front"),
        ] {
            let text = tiago.replace("[lidar]", first) + &rear.replace("[lidars.rear]", second);
            let mut model = RobotModel::from_toml(&text, "two").unwrap();
            let names: Vec<String> = model.all_lidars().map(|(name, _)| name.to_owned()).collect();
            let main: Vec<&String> = names.iter().filter(|name| model.is_main_lidar(name)).collect();
            assert_eq!((names.len(), main), (2, vec![&names[0]]));
            assert_eq!(names[0], expected, "{first} and {second}");
            let order: Vec<String> = model.all_lidars_mut().map(|(name, _)| name.to_owned()).collect();
            assert_eq!(order, names);
        }
    }

    #[test]
    fn an_option_that_does_not_exist_or_does_not_fit_is_named() {
        let said = |names: &str, text: &str| {
            RobotModel::with_options(names, |_| Ok(text.to_owned()))
                .unwrap_err()
                .to_string()
        };
        let missing = RobotModel::with_options("jackal+wings", |_| Err("no such file".to_owned())).unwrap_err();
        assert_eq!(missing.to_string(), "`wings`: no such file");
        assert!(said("jackal+mine", "[lidars.rear]\nbeams = 3").contains("rate_hz"));
        assert!(said("jackal+mine", "[lidar]\nbeams = 0").contains("`lidar.beams` is 0"));
        assert!(said("jackal+mine", "[lidar").contains("mine"));
    }
}
