//! Schemas. Foxglove's public message schemas as JSON Schema, by which its tools recognise the messages.

use serde_json::{Map, Value, json};

/// The message types written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Schema {
    /// A scan of a planar lidar.
    LaserScan,
    /// A grid on the floor.
    Grid,
    /// A pose.
    PoseInFrame,
    /// Transforms between frames.
    FrameTransforms,
    /// Shapes to draw.
    SceneUpdate,
    /// A log line.
    Log,
}

impl Schema {
    /// Foxglove's name for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::LaserScan => "foxglove.LaserScan",
            Self::Grid => "foxglove.Grid",
            Self::PoseInFrame => "foxglove.PoseInFrame",
            Self::FrameTransforms => "foxglove.FrameTransforms",
            Self::SceneUpdate => "foxglove.SceneUpdate",
            Self::Log => "foxglove.Log",
        }
    }

    /// The schema.
    #[must_use]
    pub fn json(self) -> Value {
        let fields = match self {
            Self::LaserScan => vec![
                ("timestamp", time()),
                ("frame_id", text()),
                ("pose", pose()),
                ("start_angle", number()),
                ("end_angle", number()),
                ("ranges", list(number())),
                ("intensities", list(number())),
            ],
            Self::Grid => vec![
                ("timestamp", time()),
                ("frame_id", text()),
                ("pose", pose()),
                ("column_count", count()),
                (
                    "cell_size",
                    object("foxglove.Vector2", vec![("x", number()), ("y", number())]),
                ),
                ("row_stride", count()),
                ("cell_stride", count()),
                ("fields", list(packed_field())),
                ("data", json!({ "type": "string", "contentEncoding": "base64" })),
            ],
            Self::PoseInFrame => vec![("timestamp", time()), ("frame_id", text()), ("pose", pose())],
            Self::FrameTransforms => vec![("transforms", list(transform()))],
            Self::SceneUpdate => vec![("deletions", list(deletion())), ("entities", list(entity()))],
            Self::Log => vec![
                ("timestamp", time()),
                (
                    "level",
                    choice(&["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"]),
                ),
                ("message", text()),
                ("name", text()),
                ("file", text()),
                ("line", count()),
            ],
        };
        object(self.name(), fields)
    }
}

type Fields = Vec<(&'static str, Value)>;

fn object(title: &str, fields: Fields) -> Value {
    let required: Vec<&str> = fields.iter().map(|(name, _)| *name).collect();
    let properties: Map<String, Value> = fields
        .iter()
        .map(|(name, field)| ((*name).to_owned(), field.clone()))
        .collect();
    json!({ "title": title, "type": "object", "properties": properties, "required": required })
}

fn list(item: Value) -> Value {
    json!({ "type": "array", "items": item })
}

/// A number from zero that stands for one of these names.
fn choice(names: &[&str]) -> Value {
    let choices: Vec<Value> = names
        .iter()
        .enumerate()
        .map(|(number, name)| json!({ "title": name, "const": number }))
        .collect();
    json!({ "oneOf": choices })
}

fn number() -> Value {
    json!({ "type": "number" })
}

fn count() -> Value {
    json!({ "type": "integer", "minimum": 0 })
}

fn text() -> Value {
    json!({ "type": "string" })
}

fn truth() -> Value {
    json!({ "type": "boolean" })
}

fn time() -> Value {
    let nanos = json!({ "type": "integer", "minimum": 0, "maximum": 999_999_999 });
    json!({ "type": "object", "title": "time", "properties": { "sec": count(), "nsec": nanos } })
}

fn duration() -> Value {
    let nanos = json!({ "type": "integer", "minimum": 0, "maximum": 999_999_999 });
    json!({ "type": "object", "title": "duration", "properties": { "sec": { "type": "integer" }, "nsec": nanos } })
}

fn vector3() -> Value {
    object(
        "foxglove.Vector3",
        vec![("x", number()), ("y", number()), ("z", number())],
    )
}

fn point3() -> Value {
    object(
        "foxglove.Point3",
        vec![("x", number()), ("y", number()), ("z", number())],
    )
}

fn quaternion() -> Value {
    let parts = ["x", "y", "z", "w"];
    object(
        "foxglove.Quaternion",
        parts.into_iter().map(|part| (part, number())).collect(),
    )
}

fn pose() -> Value {
    object(
        "foxglove.Pose",
        vec![("position", vector3()), ("orientation", quaternion())],
    )
}

fn color() -> Value {
    let parts = ["r", "g", "b", "a"];
    object(
        "foxglove.Color",
        parts.into_iter().map(|part| (part, number())).collect(),
    )
}

fn packed_field() -> Value {
    let types = choice(&[
        "UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64",
    ]);
    object(
        "foxglove.PackedElementField",
        vec![("name", text()), ("offset", count()), ("type", types)],
    )
}

fn transform() -> Value {
    object(
        "foxglove.FrameTransform",
        vec![
            ("timestamp", time()),
            ("parent_frame_id", text()),
            ("child_frame_id", text()),
            ("translation", vector3()),
            ("rotation", quaternion()),
        ],
    )
}

fn deletion() -> Value {
    object(
        "foxglove.SceneEntityDeletion",
        vec![
            ("timestamp", time()),
            ("type", choice(&["MATCHING_ID", "ALL"])),
            ("id", text()),
        ],
    )
}

fn entity() -> Value {
    let pair = object("foxglove.KeyValuePair", vec![("key", text()), ("value", text())]);
    object(
        "foxglove.SceneEntity",
        vec![
            ("timestamp", time()),
            ("frame_id", text()),
            ("id", text()),
            ("lifetime", duration()),
            ("frame_locked", truth()),
            ("metadata", list(pair)),
            ("arrows", list(arrow())),
            ("cubes", list(solid("foxglove.CubePrimitive"))),
            ("spheres", list(solid("foxglove.SpherePrimitive"))),
            ("cylinders", list(cylinder())),
            ("lines", list(line())),
            ("triangles", list(triangles())),
            ("texts", list(words())),
            ("models", list(model())),
        ],
    )
}

fn arrow() -> Value {
    object(
        "foxglove.ArrowPrimitive",
        vec![
            ("pose", pose()),
            ("shaft_length", number()),
            ("shaft_diameter", number()),
            ("head_length", number()),
            ("head_diameter", number()),
            ("color", color()),
        ],
    )
}

fn solid(title: &str) -> Value {
    object(title, vec![("pose", pose()), ("size", vector3()), ("color", color())])
}

fn cylinder() -> Value {
    object(
        "foxglove.CylinderPrimitive",
        vec![
            ("pose", pose()),
            ("size", vector3()),
            ("bottom_scale", number()),
            ("top_scale", number()),
            ("color", color()),
        ],
    )
}

fn line() -> Value {
    object(
        "foxglove.LinePrimitive",
        vec![
            ("type", choice(&["LINE_STRIP", "LINE_LOOP", "LINE_LIST"])),
            ("pose", pose()),
            ("thickness", number()),
            ("scale_invariant", truth()),
            ("points", list(point3())),
            ("color", color()),
            ("colors", list(color())),
            ("indices", list(count())),
        ],
    )
}

fn triangles() -> Value {
    object(
        "foxglove.TriangleListPrimitive",
        vec![
            ("pose", pose()),
            ("points", list(point3())),
            ("color", color()),
            ("colors", list(color())),
            ("indices", list(count())),
        ],
    )
}

fn words() -> Value {
    object(
        "foxglove.TextPrimitive",
        vec![
            ("pose", pose()),
            ("billboard", truth()),
            ("font_size", number()),
            ("scale_invariant", truth()),
            ("color", color()),
            ("text", text()),
        ],
    )
}

fn model() -> Value {
    object(
        "foxglove.ModelPrimitive",
        vec![
            ("pose", pose()),
            ("scale", vector3()),
            ("color", color()),
            ("override_color", truth()),
            ("url", text()),
            ("media_type", text()),
            ("data", json!({ "type": "string", "contentEncoding": "base64" })),
        ],
    )
}
