//! How does a behaviour tree look on paper? From left to right, a box a node, as SVG or PNG.
//!
//! Leaves stand below one another, a parent beside the middle of its children; columns are as wide as their widest box.

use std::fmt::Write as _;

use zenav_behaviour_tree::NodeReport;

use super::glyphs;
use crate::failure::Failure;

/// Red, green, blue.
type Color = [u8; 3];

/// Height of a box, and of a row, in units of the picture.
const BOX: usize = 22;
const ROW: usize = 30;
/// Width of a letter, and what a box has beside its text.
const LETTER: usize = 7;
const PADDING: usize = 8;
/// Between two columns, and around everything.
const GAP: usize = 36;
const MARGIN: usize = 12;
/// Letters shown of a name.
const LONGEST: usize = 60;
/// Dots of a PNG a unit of the picture.
const ZOOM: usize = 2;
/// Largest PNG, dots.
const MAX_DOTS: usize = 100_000_000;
const LINE: Color = [120, 126, 134];
const INK: Color = [24, 28, 34];

/// Colours of the categories, as Groot2 tells them apart.
fn color(category: &str) -> Color {
    match category {
        "Action" => [205, 228, 205],
        "Condition" => [250, 226, 178],
        "Control" => [203, 220, 245],
        "Decorator" => [228, 212, 240],
        _ => [226, 228, 231],
    }
}

/// One node's box, upper left corner and size.
#[derive(Debug)]
struct Card {
    left: usize,
    top: usize,
    width: usize,
    label: String,
    color: Color,
    parent: Option<usize>,
}

/// Every box, and the size of the picture.
#[derive(Debug)]
struct Layout {
    cards: Vec<Card>,
    width: usize,
    height: usize,
}

fn label(node: &NodeReport) -> String {
    let name: String = node
        .name
        .chars()
        .filter(|letter| !letter.is_control())
        .take(LONGEST)
        .collect();
    if node.id == node.name {
        name
    } else {
        let id: String = node
            .id
            .chars()
            .filter(|letter| !letter.is_control())
            .take(LONGEST)
            .collect();
        format!("{name} [{id}]")
    }
}

fn layout(nodes: &[NodeReport]) -> Layout {
    let labels: Vec<String> = nodes.iter().map(label).collect();
    let width_of = |label: &String| label.chars().count() * LETTER + 2 * PADDING;
    let depth_of = |node: &NodeReport| usize::from(node.depth);
    let mut columns: Vec<usize> = Vec::new();
    for (node, label) in nodes.iter().zip(&labels) {
        let depth = depth_of(node);
        columns.resize(columns.len().max(depth + 1), 0);
        if let Some(column) = columns.get_mut(depth) {
            *column = (*column).max(width_of(label));
        }
    }
    let mut lefts = vec![MARGIN];
    for column in &columns {
        lefts.push(lefts.last().copied().unwrap_or(MARGIN) + column + GAP);
    }
    // Document order: children come after their parent, so that from the end every child is placed before its parent.
    let mut spans: Vec<Option<(usize, usize)>> = vec![None; nodes.len()];
    let mut tops = vec![0; nodes.len()];
    let is_leaf: Vec<bool> = (0..nodes.len())
        .map(|index| {
            nodes
                .get(index + 1)
                .is_none_or(|next| next.depth <= nodes.get(index).map_or(0, |node| node.depth))
        })
        .collect();
    let rows = is_leaf.iter().filter(|leaf| **leaf).count();
    let mut row = rows;
    for index in (0..nodes.len()).rev() {
        let top = match spans.get(index).copied().flatten() {
            Some((first, last)) => (first + last) / 2,
            None => {
                row = row.saturating_sub(1);
                MARGIN + row * ROW
            }
        };
        if let Some(slot) = tops.get_mut(index) {
            *slot = top;
        }
        let parent = nodes
            .get(index)
            .and_then(|node| node.parent)
            .map(|uid| usize::from(uid) - 1);
        if let Some(span) = parent.and_then(|parent| spans.get_mut(parent)) {
            *span = Some(span.map_or((top, top), |(first, last)| (first.min(top), last.max(top))));
        }
    }
    let cards = nodes
        .iter()
        .zip(labels)
        .zip(tops)
        .map(|((node, label), top)| Card {
            left: lefts.get(depth_of(node)).copied().unwrap_or(MARGIN),
            top,
            width: width_of(&label),
            label,
            color: color(&node.category),
            parent: node.parent.map(|uid| usize::from(uid) - 1),
        })
        .collect();
    Layout {
        cards,
        width: lefts.last().copied().unwrap_or(MARGIN) + MARGIN - GAP,
        height: rows * ROW + 2 * MARGIN - (ROW - BOX),
    }
}

impl Layout {
    /// From the right side of each parent to the left side of its child.
    fn edges(&self) -> impl Iterator<Item = [(usize, usize); 2]> {
        self.cards.iter().filter_map(|card| {
            let parent = self.cards.get(card.parent?)?;
            let from = (parent.left + parent.width, parent.top + BOX / 2);
            Some([from, (card.left, card.top + BOX / 2)])
        })
    }
}

/// A tree as SVG.
pub(super) fn svg(nodes: &[NodeReport]) -> String {
    let picture = layout(nodes);
    let (width, height) = (picture.width, picture.height);
    let hex = |[r, g, b]: Color| format!("#{r:02x}{g:02x}{b:02x}");
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" font-family=\"monospace\" font-size=\"11\">\n"
    );
    // Writing to a String cannot fail.
    for [(x1, y1), (x2, y2)] in picture.edges() {
        let middle = (x1 + x2) / 2;
        let _ = writeln!(
            text,
            "<path d=\"M{x1} {y1} C{middle} {y1} {middle} {y2} {x2} {y2}\" fill=\"none\" stroke=\"{}\"/>",
            hex(LINE)
        );
    }
    for card in &picture.cards {
        let Card { left, top, width, .. } = card;
        let _ = writeln!(
            text,
            "<rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{BOX}\" rx=\"4\" fill=\"{}\" stroke=\"{}\"/>",
            hex(card.color),
            hex(LINE)
        );
        // As wide as its letters are taken to be, whatever font there is.
        let _ = writeln!(
            text,
            "<text x=\"{}\" y=\"{}\" textLength=\"{}\" fill=\"{}\">{}</text>",
            left + PADDING,
            top + 15,
            width - 2 * PADDING,
            hex(INK),
            escaped(&card.label)
        );
    }
    text.push_str("</svg>\n");
    text
}

fn escaped(text: &str) -> String {
    let mut safe = String::new();
    for letter in text.chars() {
        match letter {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            other => safe.push(other),
        }
    }
    safe
}

/// A tree as PNG.
///
/// # Errors
/// A tree too large for a picture of dots.
pub(super) fn png(nodes: &[NodeReport]) -> Result<Vec<u8>, Failure> {
    let picture = layout(nodes);
    let mut canvas = Canvas::new(picture.width * ZOOM, picture.height * ZOOM)?;
    for [from, to] in picture.edges() {
        canvas.elbow(from, to);
    }
    for card in &picture.cards {
        canvas.card(card);
    }
    canvas.encode()
}

/// Dots, row by row from the top.
struct Canvas {
    width: usize,
    height: usize,
    dots: Vec<u8>,
}

impl Canvas {
    fn new(width: usize, height: usize) -> Result<Self, Failure> {
        if width.saturating_mul(height) > MAX_DOTS {
            return Err(Failure::usage(format!(
                "the tree is too large for a PNG ({width} by {height} dots): expected a file name that ends with .svg"
            )));
        }
        Ok(Self {
            width,
            height,
            dots: vec![255; width * height * 3],
        })
    }

    fn set(&mut self, x: usize, y: usize, color: Color) {
        if x < self.width && y < self.height {
            let at = (y * self.width + x) * 3;
            if let Some(dot) = self.dots.get_mut(at..at + 3) {
                dot.copy_from_slice(&color);
            }
        }
    }

    /// A rectangle in units of the picture.
    fn fill(&mut self, (left, top): (usize, usize), (width, height): (usize, usize), color: Color) {
        for y in top * ZOOM..(top + height) * ZOOM {
            for x in left * ZOOM..(left + width) * ZOOM {
                self.set(x, y, color);
            }
        }
    }

    /// Right, up or down, and right.
    fn elbow(&mut self, (x1, y1): (usize, usize), (x2, y2): (usize, usize)) {
        let middle = x2.saturating_sub(GAP / 2).max(x1);
        self.fill((x1, y1), (middle - x1 + 1, 1), LINE);
        self.fill((middle, y1.min(y2)), (1, y1.abs_diff(y2) + 1), LINE);
        self.fill((middle, y2), (x2.saturating_sub(middle), 1), LINE);
    }

    fn card(&mut self, card: &Card) {
        self.fill((card.left, card.top), (card.width, BOX), LINE);
        self.fill((card.left + 1, card.top + 1), (card.width - 2, BOX - 2), card.color);
        let top = (card.top + (BOX - glyphs::HEIGHT) / 2) * ZOOM;
        for (place, letter) in card.label.chars().enumerate() {
            let left = (card.left + PADDING + place * LETTER) * ZOOM;
            for row in 0..glyphs::HEIGHT * ZOOM {
                for column in 0..glyphs::WIDTH * ZOOM {
                    if glyphs::dot(letter, column / ZOOM, row / ZOOM) {
                        self.set(left + column, top + row, INK);
                    }
                }
            }
        }
    }

    fn encode(&self) -> Result<Vec<u8>, Failure> {
        let broken = |error: png::EncodingError| Failure::usage(error.to_string());
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().map_err(broken)?;
        writer.write_image_data(&self.dots).map_err(broken)?;
        writer.finish().map_err(broken)?;
        Ok(bytes)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_mission::trees;

    #[test]
    fn every_node_has_a_box_of_its_own_inside_the_picture() {
        for (name, _) in trees::SHIPPED {
            let picture = layout(&trees::build(name).unwrap().report());
            for (index, card) in picture.cards.iter().enumerate() {
                assert!(card.left + card.width <= picture.width && card.top + BOX <= picture.height);
                for other in picture.cards.iter().skip(index + 1) {
                    let apart = card.left + card.width <= other.left
                        || other.left + other.width <= card.left
                        || card.top + BOX <= other.top
                        || other.top + BOX <= card.top;
                    assert!(apart, "{name}: {} and {}", card.label, other.label);
                }
            }
        }
    }

    #[test]
    fn names_do_not_break_out_of_the_picture() {
        let tree = r#"<root><BehaviorTree ID="A"><AlwaysSuccess name="a &lt;b&gt; &amp; c"/></BehaviorTree></root>"#;
        let text = svg(&trees::build(tree).unwrap().report());
        assert!(
            text.contains("a &lt;b&gt; &amp; c [AlwaysSuccess]") && text.ends_with("</svg>\n"),
            "{text}"
        );
    }

    #[test]
    fn a_png_is_as_large_as_the_picture() {
        let nodes = trees::build("kitchen").unwrap().report();
        let bytes = png(&nodes).unwrap();
        let info = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let picture = layout(&nodes);
        assert_eq!(
            (info.info().width as usize, info.info().height as usize),
            (picture.width * ZOOM, picture.height * ZOOM)
        );
    }
}
