//! Picture of a behaviour tree. From left to right, one card per node, as SVG or PNG.
//!
//! Leaves are below one another, a parent is level with the middle of its children; columns are as wide as their widest card.

use std::fmt::Write as _;

use zenav_behaviour_tree::NodeReport;

use super::canvas::{Anchor, Canvas, Color, Face, INK, WHITE, text_width};
use crate::failure::Failure;
use crate::output::escape;

/// Height of a card, and of a row, px.
const CARD: f32 = 24.0;
const ROW: f32 = 32.0;
/// Size of the letters, and padding of a card around its text, px.
const LETTERS: f32 = 12.0;
const PADDING: f32 = 9.0;
/// Gap between two columns, and margin around everything, px.
const GAP: f32 = 36.0;
const MARGIN: f32 = 12.0;
/// Most letters of a name.
const LONGEST: usize = 60;
/// PNG pixels per pixel of the layout.
const ZOOM: f32 = 2.0;
const LINE: Color = [120, 126, 134];

/// Colours of the categories, as distinguished by Groot2.
fn color(category: &str) -> Color {
    match category {
        "Action" => [205, 228, 205],
        "Condition" => [250, 226, 178],
        "Control" => [203, 220, 245],
        "Decorator" => [228, 212, 240],
        _ => [226, 228, 231],
    }
}

/// Card of one node: upper left corner and width.
#[derive(Debug)]
struct Card {
    left: f32,
    top: f32,
    width: f32,
    label: String,
    color: Color,
    parent: Option<usize>,
}

/// All cards, and the size of the picture.
#[derive(Debug)]
struct Layout {
    cards: Vec<Card>,
    width: f32,
    height: f32,
}

fn label(node: &NodeReport) -> String {
    let cut = |text: &str| -> String {
        text.chars()
            .filter(|letter| !letter.is_control())
            .take(LONGEST)
            .collect()
    };
    if node.id == node.name {
        cut(&node.name)
    } else {
        format!("{} [{}]", cut(&node.name), cut(&node.id))
    }
}

fn layout(nodes: &[NodeReport]) -> Layout {
    let labels: Vec<String> = nodes.iter().map(label).collect();
    let widths: Vec<f32> = labels
        .iter()
        .map(|label| (text_width(label, LETTERS, Face::Regular) + 2.0 * PADDING).ceil())
        .collect();
    let depth_of = |node: &NodeReport| usize::from(node.depth);
    let mut columns: Vec<f32> = Vec::new();
    for (node, width) in nodes.iter().zip(&widths) {
        columns.resize(columns.len().max(depth_of(node) + 1), 0.0);
        if let Some(column) = columns.get_mut(depth_of(node)) {
            *column = column.max(*width);
        }
    }
    let mut lefts = vec![MARGIN];
    for column in &columns {
        lefts.push(lefts.last().copied().unwrap_or(MARGIN) + column + GAP);
    }
    // In document order a node is a leaf if the next one is no deeper. Going backwards, children are placed before their parents.
    let next_depths = nodes.iter().skip(1).map(|node| node.depth).chain([0]);
    let leaves: Vec<bool> = nodes
        .iter()
        .zip(next_depths)
        .map(|(node, next)| next <= node.depth)
        .collect();
    let rows = leaves.iter().filter(|leaf| **leaf).count();
    let mut row = rows;
    let mut spans: Vec<Option<(f32, f32)>> = vec![None; nodes.len()];
    let mut tops = vec![0.0; nodes.len()];
    for (index, node) in nodes.iter().enumerate().rev() {
        let top = match spans.get(index).copied().flatten() {
            Some((first, last)) => 0.5 * (first + last),
            None => {
                row = row.saturating_sub(1);
                MARGIN + row as f32 * ROW
            }
        };
        if let Some(slot) = tops.get_mut(index) {
            *slot = top;
        }
        if let Some(span) = parent(node).and_then(|parent| spans.get_mut(parent)) {
            *span = Some(span.map_or((top, top), |(first, last)| (first.min(top), last.max(top))));
        }
    }
    let cards = nodes.iter().zip(labels).zip(widths.iter().zip(tops));
    Layout {
        cards: cards
            .map(|((node, label), (width, top))| Card {
                left: lefts.get(depth_of(node)).copied().unwrap_or(MARGIN),
                top,
                width: *width,
                label,
                color: color(&node.category),
                parent: parent(node),
            })
            .collect(),
        width: lefts.last().copied().unwrap_or(MARGIN) + MARGIN - GAP,
        height: rows as f32 * ROW + 2.0 * MARGIN - (ROW - CARD),
    }
}

/// Index of a node's parent.
fn parent(node: &NodeReport) -> Option<usize> {
    node.parent.and_then(|uid| usize::from(uid).checked_sub(1))
}

impl Layout {
    /// From the right side of each parent to the left side of its child.
    fn edges(&self) -> impl Iterator<Item = [(f32, f32); 2]> {
        self.cards.iter().filter_map(|card| {
            let parent = self.cards.get(card.parent?)?;
            let from = (parent.left + parent.width, parent.top + 0.5 * CARD);
            Some([from, (card.left, card.top + 0.5 * CARD)])
        })
    }
}

/// A tree as SVG. `hints`: for each node a text that a viewer shows when the pointer rests on its card; empty for none.
pub fn svg(nodes: &[NodeReport], hints: &[String]) -> String {
    let picture = layout(nodes);
    let (width, height) = (picture.width, picture.height);
    let hex = |[r, g, b]: Color| format!("#{r:02x}{g:02x}{b:02x}");
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" font-family=\"DejaVu Sans, Verdana, sans-serif\" font-size=\"{LETTERS}\">\n"
    );
    // Writing to a String cannot fail.
    for [(x1, y1), (x2, y2)] in picture.edges() {
        let middle = 0.5 * (x1 + x2);
        let _ = writeln!(
            text,
            "<path d=\"M{x1} {y1} C{middle} {y1} {middle} {y2} {x2} {y2}\" fill=\"none\" stroke=\"{}\"/>",
            hex(LINE)
        );
    }
    let hints = hints.iter().map(String::as_str).chain(std::iter::repeat(""));
    for (card, hint) in picture.cards.iter().zip(hints) {
        let Card { left, top, width, .. } = card;
        let _ = writeln!(
            text,
            "<rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{CARD}\" rx=\"4\" fill=\"{}\" stroke=\"{}\"><title>{}</title></rect>",
            hex(card.color),
            hex(LINE),
            escape(hint)
        );
        // Stretched to the assumed width, whatever font is available.
        let _ = writeln!(
            text,
            "<text x=\"{}\" y=\"{}\" textLength=\"{}\" fill=\"{}\" pointer-events=\"none\">{}</text>",
            left + PADDING,
            top + 16.0,
            width - 2.0 * PADDING,
            hex(INK),
            escape(&card.label)
        );
    }
    text.push_str("</svg>\n");
    text
}

/// A tree as PNG.
///
/// # Errors
/// A tree too large for a bitmap.
pub fn png(nodes: &[NodeReport]) -> Result<Vec<u8>, Failure> {
    let picture = layout(nodes);
    let dots = |length: f32| (length * ZOOM).ceil() as u32;
    let mut canvas = Canvas::new(dots(picture.width), dots(picture.height), WHITE)
        .map_err(|error| Failure::usage(format!("{error}: expected a file name that ends with .svg")))?;
    for [from, to] in picture.edges() {
        let [from, to] = [from, to].map(|(x, y)| [x * ZOOM, y * ZOOM]);
        canvas.curve(from, to, LINE, ZOOM);
    }
    for card in &picture.cards {
        let (left, top, width, height) = (card.left * ZOOM, card.top * ZOOM, card.width * ZOOM, CARD * ZOOM);
        canvas.card([left, top], [width, height], 4.0 * ZOOM, LINE, 255);
        canvas.card(
            [left + 1.5, top + 1.5],
            [width - 3.0, height - 3.0],
            4.0 * ZOOM - 1.5,
            card.color,
            255,
        );
        let at = [left + PADDING * ZOOM, top + 16.0 * ZOOM];
        canvas.text(at, &card.label, LETTERS * ZOOM, INK, Anchor::Start, Face::Regular);
    }
    canvas.png()
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_mission::trees;

    #[test]
    fn every_node_has_a_box_of_its_own_inside_the_picture() {
        for (name, _) in trees::SHIPPED {
            let picture = layout(&trees::build(name).unwrap().report());
            for (index, card) in picture.cards.iter().enumerate() {
                assert!(card.left + card.width <= picture.width && card.top + CARD <= picture.height);
                for other in picture.cards.iter().skip(index + 1) {
                    let apart = card.left + card.width <= other.left
                        || other.left + other.width <= card.left
                        || card.top + CARD <= other.top
                        || other.top + CARD <= card.top;
                    assert!(apart, "{name}: {} and {}", card.label, other.label);
                }
            }
        }
    }

    #[test]
    fn names_do_not_break_out_of_the_picture() {
        let tree = r#"<root><BehaviorTree ID="A"><AlwaysSuccess name="a &lt;b&gt; &amp; c"/></BehaviorTree></root>"#;
        let text = svg(&trees::build(tree).unwrap().report(), &["a=\"<b>\"".to_owned()]);
        assert!(
            text.contains("a &lt;b&gt; &amp; c [AlwaysSuccess]") && text.ends_with("</svg>\n"),
            "{text}"
        );
        assert!(text.contains("<title>a=&quot;&lt;b&gt;&quot;</title>"), "{text}");
    }

    #[test]
    fn a_png_is_as_large_as_the_picture() {
        let nodes = trees::build("kitchen").unwrap().report();
        let bytes = png(&nodes).unwrap();
        let info = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let picture = layout(&nodes);
        assert_eq!(
            (info.info().width as usize, info.info().height as usize),
            (
                (picture.width * ZOOM).ceil() as usize,
                (picture.height * ZOOM).ceil() as usize
            )
        );
    }
}
