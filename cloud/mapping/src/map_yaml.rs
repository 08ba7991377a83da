//! Map description. Reads and writes the YAML file beside a map's image.
//!
//! Only the subset of YAML that `map_server` files use: `key: value` lines, lists in brackets or as `- item` lines, comments, quotes.
//! Unknown keys are ignored, as in `map_server`. A YAML library would cost more code than this, and its errors do not give key and line.

use std::ops::RangeInclusive;
use std::path::Path;

use nalgebra::Point2;
use thiserror::Error;
use zenav_protocol::geometry::MAX_COORDINATE;

/// The recognised keys.
const KEYS: [&str; 7] = [
    "image",
    "resolution",
    "origin",
    "negate",
    "occupied_thresh",
    "free_thresh",
    "mode",
];
/// Side of a pixel, m.
const RESOLUTION: RangeInclusive<f64> = 1e-3..=100.0;
/// An unknown key that differs from a known one in at most this many letters is taken for a typing error.
const SLIPS: usize = 2;

/// How brightness becomes occupancy, as in Nav2's `map_io`; `p` is darkness, or brightness with `negate`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MapMode {
    /// Above `occupied_thresh` occupied, below `free_thresh` free, else unknown.
    #[default]
    Trinary,
    /// As trinary, but the percentage in between; transparent pixels are unknown.
    Scale,
    /// The pixel's own value is the percentage; above 100 it is unknown.
    Raw,
}

impl MapMode {
    /// Name of the mode in the file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Trinary => "trinary",
            Self::Scale => "scale",
            Self::Raw => "raw",
        }
    }
}

/// Description of a map: the YAML file beside its image.
#[derive(Clone, Debug, PartialEq)]
pub struct MapYaml {
    /// File of the image, relative to the description.
    pub image: String,
    /// Side of a pixel, m.
    pub resolution: f64,
    /// Lower-left corner of the lower-left pixel, m.
    pub origin: Point2<f64>,
    /// Whether bright pixels are occupied.
    pub negate: bool,
    /// Above this probability a pixel is occupied (see [`MapMode`]).
    pub occupied_thresh: f64,
    /// Below this probability a pixel is free (see [`MapMode`]).
    pub free_thresh: f64,
    /// How brightness becomes occupancy.
    pub mode: MapMode,
}

/// Why a description could not be read.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum MapYamlError {
    /// A line is malformed, or its value is out of bounds.
    #[error("line {line}: {what}")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// What was expected, and what was found.
        what: String,
    },
    /// A mandatory key is missing.
    #[error("`{0}` is missing")]
    Missing(&'static str),
}

impl MapYamlError {
    /// The error with its place in this file.
    pub(crate) fn in_file(&self, path: &Path) -> String {
        match self {
            Self::Line { line, what } => format!("{}:{line}: {what}", path.display()),
            Self::Missing(_) => format!("{}: {self}", path.display()),
        }
    }
}

/// A key with its values and its line.
struct Entry {
    key: String,
    values: Vec<String>,
    line: usize,
}

impl Entry {
    fn wrong(&self, expected: &str) -> MapYamlError {
        let found = match self.values.as_slice() {
            [] => "nothing".to_owned(),
            values => format!("`{}`", values.join(", ").chars().take(80).collect::<String>()),
        };
        MapYamlError::Line {
            line: self.line,
            what: format!("`{}`: expected {expected}, found {found}", self.key),
        }
    }

    fn text(&self) -> Result<&str, MapYamlError> {
        match self.values.as_slice() {
            [value] if !value.is_empty() => Ok(value),
            _ => Err(self.wrong("one value")),
        }
    }

    fn number(&self, expected: &str, is_good: impl Fn(f64) -> bool) -> Result<f64, MapYamlError> {
        self.text()?
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite() && is_good(*value))
            .ok_or_else(|| self.wrong(expected))
    }

    fn share(&self) -> Result<f64, MapYamlError> {
        self.number("a number from 0 to 1", |value| (0.0..=1.0).contains(&value))
    }
}

impl MapYaml {
    /// A description with `map_server`'s usual thresholds.
    #[must_use]
    pub fn new(image: impl Into<String>, resolution: f64, origin: Point2<f64>) -> Self {
        Self {
            image: image.into(),
            resolution,
            origin,
            negate: false,
            occupied_thresh: 0.65,
            free_thresh: 0.196,
            mode: MapMode::Trinary,
        }
    }

    /// Parses the text of a description.
    ///
    /// # Errors
    /// [`MapYamlError`] with the line, for malformed text, missing keys and values out of bounds. A rotated map (`origin` with a yaw) is
    /// refused: grids are never rotated here.
    ///
    /// ```
    /// use zenav_mapping::map_image::MapYaml;
    ///
    /// let yaml = MapYaml::parse("image: map.pgm\nresolution: 0.05\norigin: [-1, -2, 0]\n").unwrap();
    /// assert_eq!((yaml.resolution, yaml.origin.x), (0.05, -1.0));
    /// let error = MapYaml::parse("image: map.pgm\nresolution: -1\n").unwrap_err();
    /// assert_eq!(error.to_string(), "line 2: `resolution`: expected 0.001 to 100 m, found `-1`");
    /// ```
    pub fn parse(text: &str) -> Result<Self, MapYamlError> {
        let mut yaml = Self::new(String::new(), 0.0, Point2::origin());
        let (mut has_origin, mut threshold) = (false, 0);
        let entries = entries(text)?;
        for (index, entry) in entries.iter().enumerate() {
            if KEYS.contains(&entry.key.as_str())
                && let Some(before) = entries[..index].iter().find(|before| before.key == entry.key)
            {
                return Err(MapYamlError::Line {
                    line: entry.line,
                    what: format!("`{}` is written twice: line {} has it too", entry.key, before.line),
                });
            }
            if entry.key.ends_with("_thresh") {
                threshold = entry.line;
            }
            match entry.key.as_str() {
                "image" => yaml.image = entry.text()?.to_owned(),
                "resolution" => {
                    yaml.resolution = entry.number("0.001 to 100 m", |value| RESOLUTION.contains(&value))?
                }
                "origin" => {
                    let number = |value: &String| value.parse().ok().filter(|value: &f64| value.is_finite());
                    let numbers: Option<Vec<f64>> = entry.values.iter().map(number).collect();
                    let (x, y, yaw) = match numbers.as_deref() {
                        Some([x, y]) => (*x, *y, 0.0),
                        Some([x, y, yaw]) => (*x, *y, *yaw),
                        _ => return Err(entry.wrong("[x, y, yaw] in metres and radians")),
                    };
                    if x.abs().max(y.abs()) > MAX_COORDINATE {
                        return Err(entry.wrong(&format!(
                            "[x, y, yaw], m within {MAX_COORDINATE} (choose a nearer origin for maps in coordinates of a national grid)"
                        )));
                    }
                    if yaw.abs() >= 1e-9 {
                        return Err(entry.wrong("a yaw of 0 (rotated maps are not supported: rotate the image)"));
                    }
                    yaml.origin = Point2::new(x, y);
                    has_origin = true;
                }
                "negate" => {
                    yaml.negate = match entry.text()? {
                        "1" | "true" | "True" | "yes" => true,
                        "0" | "false" | "False" | "no" => false,
                        _ => return Err(entry.wrong("0 or 1")),
                    }
                }
                "occupied_thresh" => yaml.occupied_thresh = entry.share()?,
                "free_thresh" => yaml.free_thresh = entry.share()?,
                "mode" => {
                    let modes = [MapMode::Trinary, MapMode::Scale, MapMode::Raw];
                    let name = entry.text()?;
                    // Upper or lower case, as in `map_server`.
                    yaml.mode = *modes
                        .iter()
                        .find(|mode| name.eq_ignore_ascii_case(mode.name()))
                        .ok_or_else(|| entry.wrong("trinary, scale or raw"))?;
                }
                _ => {}
            }
        }
        if yaml.image.is_empty() {
            return Err(missing(&entries, "image"));
        }
        if yaml.resolution <= 0.0 {
            return Err(missing(&entries, "resolution"));
        }
        if !has_origin {
            return Err(missing(&entries, "origin"));
        }
        if yaml.free_thresh > yaml.occupied_thresh {
            let (free, occupied) = (yaml.free_thresh, yaml.occupied_thresh);
            return Err(MapYamlError::Line {
                line: threshold,
                what: format!("`free_thresh` is {free}: expected at most `occupied_thresh`, {occupied}"),
            });
        }
        Ok(yaml)
    }

    /// Line of a key, from 1; `None` if it is absent.
    pub(crate) fn line_of(text: &str, key: &str) -> Option<usize> {
        let entry = entries(text).ok()?.into_iter().find(|entry| entry.key == key)?;
        Some(entry.line)
    }

    /// Ignored keys that look like typing errors: each with its line and the key that was meant.
    pub(crate) fn slips(text: &str) -> Vec<(usize, String, &'static str)> {
        let entries = entries(text).unwrap_or_default().into_iter();
        let slip = |entry: Entry| {
            let near = KEYS.map(|key| (strsim::osa_distance(&entry.key, key), key));
            let (_, key) = near
                .into_iter()
                .filter(|(slips, _)| (1..=SLIPS).contains(slips))
                .min()?;
            Some((entry.line, entry.key, key))
        };
        entries.filter_map(slip).collect()
    }

    /// The description as text, with all digits; `comments` come first.
    ///
    /// ```
    /// use nalgebra::Point2;
    /// use zenav_mapping::map_image::MapYaml;
    ///
    /// let yaml = MapYaml::new("kitchen.pgm", 0.05, Point2::new(-1.5, 2.0));
    /// let text = yaml.to_text(&["revision 7".to_owned()]);
    /// assert!(text.starts_with("# revision 7\nimage: kitchen.pgm\n"));
    /// assert_eq!(MapYaml::parse(&text), Ok(yaml));
    /// ```
    #[must_use]
    pub fn to_text(&self, comments: &[String]) -> String {
        let comments: String = comments
            .iter()
            .map(|comment| format!("# {}\n", comment.replace('\n', " ")))
            .collect();
        format!(
            "{comments}image: {}\nmode: {}\nresolution: {}\norigin: [{}, {}, 0]\nnegate: {}\noccupied_thresh: {}\nfree_thresh: {}\n",
            self.image,
            self.mode.name(),
            self.resolution,
            self.origin.x,
            self.origin.y,
            u8::from(self.negate),
            self.occupied_thresh,
            self.free_thresh
        )
    }
}

/// A mandatory key is missing: names the line of an unknown key that looks like a typing error of it, if there is one.
fn missing(entries: &[Entry], key: &'static str) -> MapYamlError {
    let is_slip = |entry: &&Entry| {
        !KEYS.contains(&entry.key.as_str()) && strsim::osa_distance(&entry.key.to_ascii_lowercase(), key) <= SLIPS
    };
    match entries.iter().find(is_slip) {
        Some(entry) => MapYamlError::Line {
            line: entry.line,
            what: format!(
                "unknown key `{}`: perhaps `{key}` is meant, which is missing",
                entry.key
            ),
        },
        None => MapYamlError::Missing(key),
    }
}

fn entries(text: &str) -> Result<Vec<Entry>, MapYamlError> {
    let mut entries: Vec<Entry> = Vec::new();
    // Windows editors begin a file with a byte order mark.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (index, line) in text.lines().enumerate() {
        let line_number = index + 1;
        let wrong = |what: String| MapYamlError::Line {
            line: line_number,
            what,
        };
        let content = without_comment(line).trim();
        if content.is_empty() || content == "---" || content == "..." || content.starts_with('%') {
            continue;
        }
        if content.starts_with('{') {
            let what = "`{` begins a map in one line: expected `key: value` with a line for each key";
            return Err(wrong(what.to_owned()));
        }
        if let Some(item) = content.strip_prefix("- ").or_else(|| (content == "-").then_some("")) {
            let entry = entries.last_mut();
            let entry = entry.ok_or_else(|| wrong("a list item without a key".to_owned()))?;
            entry.values.push(unquoted(item));
            continue;
        }
        let Some((key, value)) = content.split_once(':') else {
            let found: String = content.chars().take(60).collect();
            return Err(wrong(format!("expected `key: value`, found `{found}`")));
        };
        let value = value.trim();
        let values = match value.strip_prefix('[') {
            Some(list) => {
                let list = list
                    .strip_suffix(']')
                    .ok_or_else(|| wrong("`[` without `]`".to_owned()))?;
                list.split(',').map(unquoted).collect()
            }
            None if value.is_empty() => Vec::new(),
            None => vec![unquoted(value)],
        };
        entries.push(Entry {
            key: unquoted(key),
            values,
            line: line_number,
        });
    }
    Ok(entries)
}

/// A line without its comment: `#` starts one at the start of the line or after a space, outside quotes.
fn without_comment(line: &str) -> &str {
    let mut quote = None;
    let mut before = ' ';
    for (at, character) in line.char_indices() {
        match (quote, character) {
            (None, '#') if before.is_whitespace() => return &line[..at],
            (None, '"' | '\'') => quote = Some(character),
            (Some(open), _) if open == character => quote = None,
            _ => {}
        }
        before = character;
    }
    line
}

fn unquoted(value: &str) -> String {
    let value = value.trim();
    let inner = ['"', '\'']
        .iter()
        .find_map(|quote| value.strip_prefix(*quote)?.strip_suffix(*quote));
    inner.unwrap_or(value).to_owned()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn every_way_of_writing_a_description_is_read() {
        let bracketed = "# saved by a tool\nimage: 'my map.pgm'  # the picture\nmode: scale\nresolution: 5.0e-2\norigin: [-10.0, 2, 0.0]\nnegate: 1\noccupied_thresh: 0.65\nfree_thresh: 0.25\nextra: whatever\n";
        let yaml = MapYaml::parse(bracketed).unwrap();
        assert_eq!(
            (
                yaml.image.as_str(),
                yaml.mode,
                yaml.resolution,
                yaml.origin,
                yaml.negate,
                yaml.free_thresh
            ),
            ("my map.pgm", MapMode::Scale, 0.05, Point2::new(-10.0, 2.0), true, 0.25)
        );
        let listed = "---\nfree_thresh: 0.25\nimage: \"my map.pgm\"\nmode: scale\nnegate: 1\noccupied_thresh: 0.65\norigin:\n- -10.0\n- 2.0\n- 0\nresolution: 0.05\n";
        assert_eq!(MapYaml::parse(listed).unwrap(), yaml);
        let capitals = listed.replace("scale", "Scale");
        assert_eq!(MapYaml::parse(&capitals).unwrap(), yaml, "as in `map_server`");
    }

    #[test]
    fn a_mistake_is_named_with_its_line() {
        let error = |text: &str| MapYaml::parse(text).unwrap_err().to_string();
        assert_eq!(
            error("image: a.pgm\nresolution: -1\n"),
            "line 2: `resolution`: expected 0.001 to 100 m, found `-1`"
        );
        assert_eq!(
            error("image: a.pgm\nresolution 0.1\n"),
            "line 2: expected `key: value`, found `resolution 0.1`"
        );
        assert_eq!(
            error("image: a.pgm\nresolution: 0.1\norigin: [1, 2, 0.7]"),
            "line 3: `origin`: expected a yaw of 0 (rotated maps are not supported: rotate the image), found `1, 2, 0.7`"
        );
        assert_eq!(error("image: a.pgm\nresolution: 0.1\n"), "`origin` is missing");
        assert_eq!(
            error("image: a.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nfree_thresh: 0.99\nmode: scale\n"),
            "line 4: `free_thresh` is 0.99: expected at most `occupied_thresh`, 0.65"
        );
        assert_eq!(
            error("mode: grey\n"),
            "line 1: `mode`: expected trinary, scale or raw, found `grey`"
        );
        assert_eq!(error("- 3\n"), "line 1: a list item without a key");
        for origin in ["-10 -10 0", "[1]", "[1, 2, north]", "[1, inf, 0]"] {
            let told = error(&format!("image: a.pgm\nresolution: 0.1\norigin: {origin}\n"));
            let expected = "line 3: `origin`: expected [x, y, yaw] in metres and radians, found `";
            assert!(told.starts_with(expected), "{told}");
        }
        assert_eq!(
            error("image: a.pgm\nresolution: 0.1\norigin:\n  x: 1\n  y: 2\n"),
            "line 3: `origin`: expected [x, y, yaw] in metres and radians, found nothing"
        );
        for key in ["resolutoin", "Resolution", "RESOLUTION"] {
            assert_eq!(
                error(&format!("image: a.pgm\n{key}: 0.1\norigin: [0, 0, 0]\n")),
                format!("line 2: unknown key `{key}`: perhaps `resolution` is meant, which is missing")
            );
        }
        assert_eq!(
            error("image: a.pgm\nresolution: 1e-9\n"),
            "line 2: `resolution`: expected 0.001 to 100 m, found `1e-9`"
        );
        assert_eq!(
            error("image: a.pgm\norigin: [-1e99, 0, 0]\n"),
            "line 2: `origin`: expected [x, y, yaw], m within 100000 (choose a nearer origin for maps in coordinates of a national grid), found `-1e99, 0, 0`"
        );
        assert!(MapYaml::parse("image: a.pgm\nresolution: 0.1\norigin: [1e5, -1e5, 0]\n").is_ok());
        assert!(error("image: a.pgm\nresolution: 0.1\norigin: [500000, 5400000, 0]\n").contains("a nearer origin"));
        assert_eq!(
            error("resolution: 0.1\nimage: a.pgm\nresolution: 0.05\n"),
            "line 3: `resolution` is written twice: line 1 has it too"
        );
        assert_eq!(
            error("{image: a.pgm, resolution: 0.1, origin: [0, 0, 0]}\n"),
            "line 1: `{` begins a map in one line: expected `key: value` with a line for each key"
        );
    }

    #[test]
    fn a_byte_order_mark_is_passed_over_and_a_slip_is_told() {
        let text = "\u{feff}image: a.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nfree_tresh: 0.25\nvoxel: 3\n";
        assert_eq!(MapYaml::parse(text).unwrap().image, "a.pgm");
        assert_eq!(MapYaml::slips(text), [(4, "free_tresh".to_owned(), "free_thresh")]);
        assert_eq!(
            (MapYaml::line_of(text, "image"), MapYaml::line_of(text, "mode")),
            (Some(1), None)
        );
    }

    proptest! {
        #[test]
        fn a_description_comes_back_as_it_went(resolution in 1e-3..10.0, x in -1e3..1e3, y in -1e3..1e3, negate in any::<bool>()) {
            let yaml = MapYaml { negate, mode: MapMode::Raw, ..MapYaml::new("map.pgm", resolution, Point2::new(x, y)) };
            prop_assert_eq!(MapYaml::parse(&yaml.to_text(&["revision 3".into()])).unwrap(), yaml);
        }

        #[test]
        fn no_text_does_harm(text in "[a-z:#\\[\\]\\-\"' \n0-9,.]{0,200}") {
            let _ = MapYaml::parse(&text);
        }
    }
}
