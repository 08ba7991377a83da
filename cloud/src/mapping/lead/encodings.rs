//! Encodings. The forms in which the whole map is handed out.
//!
//! Encoding a large map takes longer than a scan may wait, so it runs on Tokio's blocking threads, from a snapshot.

use zenav_mapping::map_image::{self, MapMode};
use zenav_protocol::bus::Request;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{MapReply, MapRequest, Refusal};

use super::Leadership;

/// Most whole maps encoded at the same time; further clients are told to come back.
const MAX_ENCODING: usize = 4;

impl Leadership {
    /// Replies with the whole map, in the form that the selector's parameter `format` asks for.
    pub(super) fn hand_out(&mut self, request: Request<MapRequest, MapReply>) {
        if self.encoding.len() >= MAX_ENCODING {
            request.refuse(&Refusal::Busy {
                reason: format!("{MAX_ENCODING} maps are being encoded"),
            });
            return;
        }
        // Parameters that begin with `_` are Zenoh's own.
        let unknown = request
            .parameters
            .keys()
            .find(|name| *name != "format" && !name.starts_with('_'));
        if let Some(name) = unknown {
            let name: String = name.chars().take(40).collect();
            let reason = format!("no parameter `{name}`: there is `format`");
            request.refuse(&Refusal::bad_request(reason));
            return;
        }
        let format = request.parameters.get("format").map_or("json", String::as_str);
        match format {
            "json" | "cbor" => {
                let map = self.core.mapper.snapshot();
                self.encoding.spawn_blocking(move || request.reply(&map.into_reply()));
            }
            "png" | "pgm" | "yaml" => {
                let (format, map) = (format.to_owned(), self.core.mapper.snapshot());
                self.encoding.spawn_blocking(move || match file(&map.grid(), &format) {
                    Ok((bytes, mime)) => request.reply_bytes(bytes, mime),
                    Err(refusal) => request.refuse(&refusal),
                });
            }
            other => {
                let found: String = other.chars().take(40).collect();
                let reason = format!("`format` is {found}: expected json, cbor, png, pgm or yaml");
                request.refuse(&Refusal::bad_request(reason));
            }
        }
    }
}

/// The map as a file that map tools read, with its media type.
fn file(grid: &OccupancyGrid, format: &str) -> Result<(Vec<u8>, &'static str), Refusal> {
    match format {
        "pgm" => Ok((map_image::to_pgm(grid), "image/x-portable-graymap")),
        "yaml" => {
            let yaml = map_image::to_yaml(grid, MapMode::Trinary, "map.pgm");
            Ok((yaml.to_text(&[]).into_bytes(), "application/yaml"))
        }
        _ => match map_image::to_png(grid) {
            Ok(bytes) => Ok((bytes, "image/png")),
            Err(error) => Err(Refusal::internal(error)),
        },
    }
}
