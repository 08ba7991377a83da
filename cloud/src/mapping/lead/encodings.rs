//! Encodings. The forms in which the whole map is handed out.
//!
//! Encoding a large map takes longer than a scan may wait, so it runs on Tokio's blocking threads, from a snapshot.

use zenav_mapping::map_image::{self, MapMode};
use zenav_protocol::bus::Responder;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::Refusal;
use zenav_protocol::topics::{MappingReply, MappingRequest};

use super::Leadership;

/// Most whole maps encoded at the same time; further clients are told to come back.
const MAX_ENCODING: usize = 4;

impl Leadership {
    /// Replies with the whole map, in the form that the selector's parameter `format` asks for.
    pub(super) fn hand_out(&mut self, responder: Responder<MappingRequest>) {
        if self.encoding.len() >= MAX_ENCODING {
            return responder.send(Err(Refusal::Busy {
                reason: format!("{MAX_ENCODING} maps are being encoded"),
            }));
        }
        // Parameters that begin with `_` are Zenoh's own.
        let unknown = responder
            .parameters
            .keys()
            .find(|name| *name != "format" && !name.starts_with('_'));
        if let Some(name) = unknown {
            let name: String = name.chars().take(40).collect();
            let reason = format!("no parameter `{name}`: there is `format`");
            return responder.send(Err(Refusal::bad_request(reason)));
        }
        let format = responder.parameters.get("format").map_or("json", String::as_str);
        match format {
            "json" | "cbor" => {
                let map = self.core.mapper.snapshot();
                self.encoding
                    .spawn_blocking(move || responder.send(Ok(MappingReply::Map(map.into_reply()))));
            }
            "png" | "pgm" | "yaml" => {
                let (format, map) = (format.to_owned(), self.core.mapper.snapshot());
                self.encoding.spawn_blocking(move || match file(&map.grid(), &format) {
                    Ok((bytes, mime)) => responder.send_bytes(bytes, mime),
                    Err(refusal) => responder.send(Err(refusal)),
                });
            }
            other => {
                let found: String = other.chars().take(40).collect();
                let reason = format!("`format` is {found}: expected json, cbor, png, pgm or yaml");
                responder.send(Err(Refusal::bad_request(reason)));
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
