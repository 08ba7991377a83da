//! Charts. Inline SVG of a figure over time, and of the times when the nodes of a tree ran.

use std::fmt::Write as _;

use super::super::run::NodeSpan;
use crate::output::escape;

/// Size of a chart, in its own px.
const WIDTH: f64 = 860.0;
const HEIGHT: f64 = 150.0;
/// Room for numbers on the left and below.
const LEFT: f64 = 44.0;
const BELOW: f64 = 22.0;
const TOP: f64 = 8.0;
/// Most points of a curve: the minimum and the maximum within each pixel's time.
const POINTS: usize = 700;
/// Height of a timeline row.
const ROW: f64 = 18.0;
/// Room for the names to its left.
const NAMES: f64 = 230.0;
/// Most rows.
const MOST_ROWS: usize = 48;

/// Tick distance for about so many ticks: 1, 2 or 5 times a power of ten.
fn step(range: f64, steps: f64) -> f64 {
    let rough = (range / steps).max(1e-9);
    let power = 10_f64.powf(rough.log10().floor());
    let share = rough / power;
    power
        * if share <= 1.0 {
            1.0
        } else if share <= 2.0 {
            2.0
        } else if share <= 5.0 {
            5.0
        } else {
            10.0
        }
}

fn places(low: f64, high: f64, steps: f64) -> Vec<f64> {
    let step = step(high - low, steps);
    let mut at = (low / step).ceil() * step;
    let mut places = Vec::new();
    while at <= high + 1e-9 * step && places.len() < 100 {
        places.push(at);
        at += step;
    }
    places
}

fn label(value: f64, step: f64) -> String {
    let digits = if step >= 1.0 {
        0
    } else {
        (-step.log10()).ceil() as usize
    };
    format!("{:.*}", digits.min(4), if value.abs() < 1e-12 { 0.0 } else { value })
}

/// At most [`POINTS`] points that keep every peak.
fn thinned(series: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if series.len() <= POINTS {
        return series.to_vec();
    }
    let each = series.len().div_ceil(POINTS / 2);
    let mut points = Vec::with_capacity(POINTS);
    for part in series.chunks(each) {
        let by = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let mut both: Vec<(f64, f64)> = part
            .iter()
            .min_by(by)
            .into_iter()
            .chain(part.iter().max_by(by))
            .copied()
            .collect();
        both.sort_by(|a, b| a.0.total_cmp(&b.0));
        points.extend(both);
    }
    points
}

/// A series over time, s, with the times of warnings marked.
pub fn line(series: &[(f64, f64)], secs: f64, marks: &[f64], label_of: &str) -> String {
    let finite: Vec<(f64, f64)> = series.iter().filter(|(_, value)| value.is_finite()).copied().collect();
    let low = finite.iter().map(|(_, value)| *value).fold(0.0, f64::min);
    let high = finite.iter().map(|(_, value)| *value).fold(low + 0.1, f64::max);
    let secs = secs.max(1e-3);
    let x = |time: f64| LEFT + (WIDTH - LEFT - 6.0) * (time / secs).clamp(0.0, 1.0);
    let y = |value: f64| TOP + (HEIGHT - TOP - BELOW) * (1.0 - (value - low) / (high - low));
    let mut svg = format!(
        "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
        escape(label_of)
    );
    for value in places(low, high, 4.0) {
        let at = y(value);
        let text = label(value, step(high - low, 4.0));
        let _ = write!(
            svg,
            "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{WIDTH}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/><text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\">{text}</text>",
            LEFT - 6.0,
            at + 3.5
        );
    }
    svg.push_str(&time_axis(secs, HEIGHT, LEFT, WIDTH));
    for mark in marks {
        let at = x(*mark);
        let _ = write!(
            svg,
            "<line class=\"mark\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{:.1}\"/>",
            HEIGHT - BELOW
        );
    }
    let points: Vec<String> = thinned(&finite)
        .into_iter()
        .map(|(time, value)| format!("{:.1},{:.1}", x(time), y(value)))
        .collect();
    let _ = write!(svg, "<polyline class=\"curve\" points=\"{}\"/></svg>", points.join(" "));
    svg
}

fn time_axis(secs: f64, height: f64, left: f64, width: f64) -> String {
    let mut svg = String::new();
    let apart = step(secs, 8.0);
    for time in places(0.0, secs, 8.0) {
        let at = left + (width - left - 6.0) * time / secs;
        let _ = write!(
            svg,
            "<line class=\"grid\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{:.1}\"/><text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{} s</text>",
            height - BELOW,
            height - 6.0,
            label(time, apart)
        );
    }
    svg
}

/// When the nodes of the trees ran; one row for each node of a goal's tree, in order of their first run.
pub fn timeline(spans: &[NodeSpan], secs: f64) -> String {
    let mut rows: Vec<(&NodeSpan, Vec<&NodeSpan>)> = Vec::new();
    for span in spans {
        if let Some((_, of)) = rows.iter_mut().find(|(first, _)| first.node == span.node) {
            of.push(span);
        } else if rows.len() < MOST_ROWS {
            rows.push((span, vec![span]));
        }
    }
    // Document order, one goal after another.
    let mut goals: Vec<&str> = Vec::new();
    for (first, _) in &rows {
        if !goals.contains(&first.node.0.as_str()) {
            goals.push(&first.node.0);
        }
    }
    let place = |goal: &str| goals.iter().position(|known| *known == goal);
    rows.sort_by_key(|(first, _)| (place(&first.node.0), first.node.1));
    let secs = secs.max(1e-3);
    let height = TOP + ROW * rows.len() as f64 + BELOW;
    let x = |time: f64| NAMES + (WIDTH - NAMES - 6.0) * (time / secs).clamp(0.0, 1.0);
    let mut svg = format!(
        "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" aria-label=\"nodes of the behaviour tree over time\">"
    );
    svg.push_str(&time_axis(secs, height, NAMES, WIDTH));
    for (number, (first, of)) in rows.iter().enumerate() {
        let top = TOP + ROW * number as f64;
        let _ = write!(
            svg,
            "<text x=\"{:.0}\" y=\"{:.1}\">{}</text>",
            8.0 * first.depth.min(10) as f64,
            top + 12.5,
            escape(&shortened(&first.name, 30usize.saturating_sub(first.depth)))
        );
        for span in of {
            let (from, to) = (x(span.from), x(span.to));
            let class = match span.status.as_str() {
                "SUCCESS" => "success",
                "FAILURE" => "failure",
                "RUNNING" => "running",
                _ => "halted",
            };
            let _ = write!(
                svg,
                "<rect class=\"{class}\" x=\"{from:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.0}\"><title>{} {:.1} to {:.1} s: {}</title></rect>",
                top + 2.5,
                (to - from).max(1.5),
                ROW - 6.0,
                escape(&span.name),
                span.from,
                span.to,
                escape(&span.status.to_lowercase())
            );
        }
    }
    svg.push_str("</svg>");
    svg
}

fn shortened(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most.saturating_sub(1)).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_have_round_numbers() {
        assert_eq!(places(0.0, 10.0, 5.0), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert!((step(0.83, 4.0) - 0.5).abs() < 1e-12);
        assert_eq!(label(0.2, 0.1), "0.2");
        assert_eq!(label(200.0, 50.0), "200");
    }

    #[test]
    fn a_long_series_keeps_its_peaks() {
        let mut series: Vec<(f64, f64)> = (0..100_000).map(|nth| (f64::from(nth), 0.0)).collect();
        series[54_321].1 = 7.0;
        let thinned = thinned(&series);
        assert!(thinned.len() <= POINTS);
        assert!(thinned.iter().any(|(_, value)| *value >= 7.0));
    }

    #[test]
    fn nothing_makes_an_empty_chart() {
        assert!(line(&[], 0.0, &[], "x").contains("</svg>"));
        assert!(timeline(&[], 0.0).contains("</svg>"));
        assert!(!line(&[(0.0, f64::NAN), (1.0, f64::INFINITY)], 1.0, &[], "x").contains("NaN"));
    }
}
