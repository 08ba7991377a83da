//! World tables. The tables and keys of a world file; anything else is an error.

use serde::Deserialize;
use toml::Spanned;
use zenav_protocol::config_text::Pair;

use crate::manners::Manners;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WorldFile {
    pub(super) name: Option<Spanned<String>>,
    pub(super) size: Option<Spanned<Pair>>,
    pub(super) origin: Option<Spanned<Pair>>,
    pub(super) start: Option<Spanned<StartTable>>,
    pub(super) map: Option<MapTable>,
    #[serde(default)]
    pub(super) polygon: Vec<PolygonTable>,
    #[serde(default)]
    pub(super) circle: Vec<Spanned<CircleTable>>,
    #[serde(default)]
    pub(super) wall: Vec<Spanned<WallTable>>,
    #[serde(default)]
    pub(super) mover: Vec<Spanned<MoverTable>>,
    #[serde(default)]
    pub(super) door: Vec<Spanned<DoorTable>>,
    #[serde(default)]
    pub(super) fault: Vec<Spanned<FaultTable>>,
    #[serde(default)]
    pub(super) place: Vec<Spanned<PlaceTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StartTable {
    pub(super) x: f64,
    pub(super) y: f64,
    #[serde(default)]
    pub(super) yaw: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MapTable {
    pub(super) yaml: Spanned<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PolygonTable {
    pub(super) points: Spanned<Vec<Pair>>,
    #[serde(default)]
    pub(super) glass: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CircleTable {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) radius: Spanned<f64>,
    #[serde(default)]
    pub(super) glass: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WallTable {
    pub(super) from: Pair,
    pub(super) to: Spanned<Pair>,
    pub(super) thickness: Spanned<f64>,
    #[serde(default)]
    pub(super) glass: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MoverTable {
    pub(super) radius: Option<Spanned<f64>>,
    pub(super) polygon: Option<Spanned<Vec<Pair>>>,
    pub(super) path: Option<Spanned<Vec<Pair>>>,
    pub(super) rest_secs: Option<Spanned<Vec<f64>>>,
    pub(super) walk: Option<Spanned<Vec<Pair>>>,
    pub(super) start: Option<Spanned<Pair>>,
    pub(super) speed: Spanned<f64>,
    pub(super) manners: Option<Spanned<Manners>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DoorTable {
    pub(super) from: Pair,
    pub(super) to: Spanned<Pair>,
    pub(super) thickness: Spanned<f64>,
    pub(super) closed_secs: Spanned<f64>,
    pub(super) open_secs: Spanned<f64>,
    #[serde(default = "slide_secs")]
    pub(super) slide_secs: Spanned<f64>,
    #[serde(default)]
    pub(super) starts_open: bool,
}

/// Default time for a door to slide, s.
fn slide_secs() -> Spanned<f64> {
    Spanned::new(0..0, 2.0)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FaultTable {
    pub(super) robot: Option<Spanned<String>>,
    pub(super) sensor: Spanned<String>,
    pub(super) kind: FaultName,
    pub(super) amount: Option<Spanned<f64>>,
    #[serde(default = "at_once")]
    pub(super) from: Spanned<f64>,
    pub(super) until: Option<Spanned<f64>>,
}

/// Kind of fault, by name.
#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum FaultName {
    Dead,
    Lost,
    Late,
    Noisy,
}

/// Default beginning of a fault, s.
fn at_once() -> Spanned<f64> {
    Spanned::new(0..0, 0.0)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlaceTable {
    pub(super) name: Spanned<String>,
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) yaw: Option<f64>,
}
