//! Map tiles of a client. Which part of the map does it lack, and what is sent next?
//!
//! A client's state is the last revision it was told of and the list of tiles it still lacks: coordinates, never cells. So a map of any
//! size is sent in pieces with their newest cells, and a client that does not read costs only its list.

use std::collections::BTreeSet;

use zenav_protocol::grid::GridSpec;
use zenav_protocol::messages::TILE;

use super::RobotView;

/// Most tiles in a message: 128 are 512 KiB.
const MAX_TILES: usize = 128;

/// What a client has of a robot's map.
#[derive(Debug, Default)]
pub(crate) struct TileCursor {
    map: String,
    revision: u64,
    spec: Option<GridSpec>,
    owed: BTreeSet<(u32, u32)>,
}

impl TileCursor {
    /// The next message for the client: length of the header (4 bytes, little-endian), the header in JSON, then 4096 cells for each of the
    /// header's tiles, row by row from the lowest; -1 is unknown, 0 free, 100 occupied. `None` when the client is up to date.
    pub(crate) fn next(&mut self, robot: &str, view: &RobotView) -> Option<Vec<u8>> {
        let replica = &view.map;
        if !replica.has_map() {
            return None;
        }
        let spec = *replica.grid().spec();
        let fresh = self.map != replica.map().id || self.spec != Some(spec);
        if fresh {
            self.owed.clear();
            self.revision = 0;
            self.map.clone_from(&replica.map().id);
            self.spec = Some(spec);
        }
        if self.revision < replica.map().revision || fresh {
            let since = if fresh { 0 } else { self.revision };
            self.owed.extend(replica.changed_since(since));
            if fresh {
                let (columns, rows) = (spec.width.div_ceil(TILE), spec.height.div_ceil(TILE));
                self.owed
                    .extend((0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))));
            }
            self.revision = replica.map().revision;
        }
        if self.owed.is_empty() && !fresh {
            return None;
        }
        let tiles: Vec<(u32, u32)> = self.owed.iter().copied().take(MAX_TILES).collect();
        for tile in &tiles {
            self.owed.remove(tile);
        }
        let header = serde_json::json!({
            "type": "map", "robot": robot, "id": self.map, "revision": self.revision,
            "origin": [spec.origin.x, spec.origin.y], "resolution": spec.resolution, "width": spec.width, "height": spec.height,
            "left": self.owed.len(), "tiles": tiles,
        })
        .to_string();
        let side = TILE as usize;
        let mut message = Vec::with_capacity(4 + header.len() + tiles.len() * side * side);
        message.extend_from_slice(&u32::try_from(header.len()).unwrap_or_default().to_le_bytes());
        message.extend_from_slice(header.as_bytes());
        let (width, height) = (spec.width as usize, spec.height as usize);
        let values = replica.grid().values();
        for (x, y) in tiles {
            let (x, y) = (x as usize * side, y as usize * side);
            for row in y..y + side {
                let cells = if row < height && x < width {
                    values.get(row * width + x..row * width + (x + side).min(width))
                } else {
                    None
                };
                let cells = cells.unwrap_or_default();
                message.extend(cells.iter().map(|value| value.cast_unsigned()));
                message.extend(std::iter::repeat_n(u8::MAX, side - cells.len()));
            }
        }
        Some(message)
    }
}
