//! Messages. Foxglove's own messages: the fields of its public schemas that are used here.
//!
//! <https://docs.foxglove.dev/docs/sdk/schemas>: metres, radians, z up; an orientation is a unit quaternion; bytes are base64.

use nalgebra::Point2;
use serde::Serialize;
use zenav_protocol::geometry::Pose2;

/// A point in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Time {
    sec: u64,
    nsec: u64,
}

impl Time {
    /// From ns since the UNIX epoch.
    #[must_use]
    pub const fn from_nanos(nanos: u64) -> Self {
        Self {
            sec: nanos / 1_000_000_000,
            nsec: nanos % 1_000_000_000,
        }
    }
}

/// A vector or a point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Vector3 {
    x: f64,
    y: f64,
    z: f64,
}

impl Vector3 {
    /// From its coordinates, m.
    #[must_use]
    pub const fn new(x: f64, y: f64, z: f64) -> Self {
        Self { x, y, z }
    }

    /// A point of the plane, at this height above the floor, m.
    #[must_use]
    pub fn above(point: Point2<f64>, z: f64) -> Self {
        Self::new(point.x, point.y, z)
    }
}

/// A rotation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

impl Quaternion {
    /// About z, rad.
    #[must_use]
    pub fn about_z(yaw: f64) -> Self {
        let (z, w) = (0.5 * yaw).sin_cos();
        Self { x: 0.0, y: 0.0, z, w }
    }
}

/// A pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pose {
    position: Vector3,
    orientation: Quaternion,
}

impl From<Pose2> for Pose {
    fn from(pose: Pose2) -> Self {
        Self {
            position: Vector3::new(pose.x, pose.y, 0.0),
            orientation: Quaternion::about_z(pose.yaw),
        }
    }
}

impl Pose {
    /// A pose at a point, without rotation.
    #[must_use]
    pub fn at(position: Vector3) -> Self {
        Self {
            position,
            orientation: Quaternion::about_z(0.0),
        }
    }
}

/// A colour, each component 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Color {
    r: f64,
    g: f64,
    b: f64,
    a: f64,
}

impl Color {
    /// From red, green and blue of 0 to 255, and an opacity.
    #[must_use]
    pub fn rgb([r, g, b]: [u8; 3], a: f64) -> Self {
        let part = |part: u8| f64::from(part) / 255.0;
        Self {
            r: part(r),
            g: part(g),
            b: part(b),
            a,
        }
    }
}

/// `foxglove.LaserScan`. A beam without a return has range 0: JSON has no infinity.
#[derive(Debug, Serialize)]
pub struct LaserScan<'a> {
    pub timestamp: Time,
    pub frame_id: &'a str,
    pub pose: Pose,
    pub start_angle: f64,
    pub end_angle: f64,
    pub ranges: Vec<f32>,
    pub intensities: [f64; 0],
}

/// `foxglove.PoseInFrame`.
#[derive(Debug, Serialize)]
pub struct PoseInFrame<'a> {
    pub timestamp: Time,
    pub frame_id: &'a str,
    pub pose: Pose,
}

/// `foxglove.FrameTransforms`.
#[derive(Debug, Serialize)]
pub struct FrameTransforms {
    pub transforms: Vec<FrameTransform>,
}

/// `foxglove.FrameTransform`: the child's pose in its parent.
#[derive(Debug, Serialize)]
pub struct FrameTransform {
    timestamp: Time,
    parent_frame_id: String,
    child_frame_id: String,
    translation: Vector3,
    rotation: Quaternion,
}

impl FrameTransform {
    /// `parent_from_child` at a time.
    #[must_use]
    pub fn new(timestamp: Time, parent: String, child: String, parent_from_child: Pose2) -> Self {
        let pose = Pose::from(parent_from_child);
        Self {
            timestamp,
            parent_frame_id: parent,
            child_frame_id: child,
            translation: pose.position,
            rotation: pose.orientation,
        }
    }
}

/// `foxglove.PackedElementField`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PackedElementField {
    pub name: &'static str,
    pub offset: u32,
    #[serde(rename = "type")]
    pub kind: u8,
}

/// `foxglove.Vector2`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Vector2 {
    pub x: f64,
    pub y: f64,
}

/// `foxglove.Grid`.
#[derive(Debug, Serialize)]
pub struct Grid<'a> {
    pub timestamp: Time,
    pub frame_id: &'a str,
    pub pose: Pose,
    pub column_count: u32,
    pub cell_size: Vector2,
    pub row_stride: u32,
    pub cell_stride: u32,
    pub fields: [PackedElementField; 4],
    pub data: String,
}

/// `foxglove.Log`.
#[derive(Debug, Serialize)]
pub struct Log<'a> {
    pub timestamp: Time,
    pub level: u8,
    pub message: String,
    pub name: &'a str,
    pub file: &'a str,
    pub line: u32,
}

/// Levels of a [`Log`].
pub const INFO: u8 = 2;
/// Needs attention.
pub const WARNING: u8 = 3;
/// An error.
pub const ERROR: u8 = 4;

/// `foxglove.LinePrimitive`.
#[derive(Debug, Serialize)]
pub struct Line {
    #[serde(rename = "type")]
    pub kind: u8,
    pub pose: Pose,
    pub thickness: f64,
    pub scale_invariant: bool,
    pub points: Vec<Vector3>,
    pub color: Color,
    pub colors: [Color; 0],
    pub indices: [u32; 0],
}

/// Kinds of a [`Line`]: connected points.
pub const STRIP: u8 = 0;
/// Connected points, closed.
pub const LOOP: u8 = 1;
/// Pairs of points, each a segment.
pub const LIST: u8 = 2;

impl Line {
    /// A line of this thickness, m.
    #[must_use]
    pub fn new(kind: u8, points: Vec<Vector3>, thickness: f64, color: Color) -> Self {
        Self {
            kind,
            pose: Pose::from(Pose2::IDENTITY),
            thickness,
            scale_invariant: false,
            points,
            color,
            colors: [],
            indices: [],
        }
    }
}

/// `foxglove.CylinderPrimitive`.
#[derive(Debug, Serialize)]
pub struct Cylinder {
    pub pose: Pose,
    pub size: Vector3,
    pub bottom_scale: f64,
    pub top_scale: f64,
    pub color: Color,
}

impl Cylinder {
    /// A disc on the floor: its centre, radius and height, m.
    #[must_use]
    pub fn on_floor(at: Point2<f64>, radius: f64, height: f64, color: Color) -> Self {
        Self {
            pose: Pose::at(Vector3::above(at, 0.5 * height)),
            size: Vector3::new(2.0 * radius, 2.0 * radius, height),
            bottom_scale: 1.0,
            top_scale: 1.0,
            color,
        }
    }
}

/// `foxglove.SceneEntity`; kinds of shapes that are not used here are empty.
#[derive(Debug, Serialize)]
pub struct SceneEntity {
    pub timestamp: Time,
    pub frame_id: String,
    pub id: String,
    pub lifetime: Time,
    pub frame_locked: bool,
    pub metadata: [u8; 0],
    pub arrows: [u8; 0],
    pub cubes: [u8; 0],
    pub spheres: [u8; 0],
    pub cylinders: Vec<Cylinder>,
    pub lines: Vec<Line>,
    pub triangles: [u8; 0],
    pub texts: [u8; 0],
    pub models: [u8; 0],
}

impl SceneEntity {
    /// An entity without shapes; it stays until replaced by another one with its id.
    #[must_use]
    pub fn new(timestamp: Time, frame: &str, id: &str) -> Self {
        Self {
            timestamp,
            frame_id: frame.to_owned(),
            id: id.to_owned(),
            lifetime: Time::from_nanos(0),
            frame_locked: false,
            metadata: [],
            arrows: [],
            cubes: [],
            spheres: [],
            cylinders: Vec::new(),
            lines: Vec::new(),
            triangles: [],
            texts: [],
            models: [],
        }
    }
}

/// `foxglove.SceneEntityDeletion`, of one id.
#[derive(Debug, Serialize)]
pub struct SceneEntityDeletion {
    pub timestamp: Time,
    #[serde(rename = "type")]
    pub kind: u8,
    pub id: String,
}

/// `foxglove.SceneUpdate`.
#[derive(Debug, Default, Serialize)]
pub struct SceneUpdate {
    pub deletions: Vec<SceneEntityDeletion>,
    pub entities: Vec<SceneEntity>,
}
