//! How is a search drawn? Cost by generation, each unseen room before and after, and the distance error over time in one; as SVG.

use std::fmt::Write as _;

use super::tune::{Traces, TuneReport};

/// Size of the picture and of a panel's inner part, px.
const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 640.0;
const BEFORE: &str = "#9aa4b2";
const AFTER: &str = "#1f6fd0";

/// A rectangle with scales.
struct Panel {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
    x: (f64, f64),
    y: (f64, f64),
}

impl Panel {
    fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let share = |value: f64, (low, high): (f64, f64)| (value - low) / (high - low).max(1e-12);
        (
            self.left + self.width * share(x, self.x),
            self.top + self.height * (1.0 - share(y, self.y)),
        )
    }

    /// Axes with five marks on the left, and a title.
    fn frame(&self, out: &mut String, title: &str, across: &str) {
        // Writing to a String cannot fail.
        let _ = writeln!(
            out,
            r##"<text x="{}" y="{}" class="t">{title}</text><text x="{}" y="{}" text-anchor="middle">{across}</text>"##,
            self.left,
            self.top - 12.0,
            self.left + 0.5 * self.width,
            self.top + self.height + 32.0
        );
        for mark in 0..=4 {
            let value = self.y.0 + (self.y.1 - self.y.0) * f64::from(mark) / 4.0;
            let (_, y) = self.at(self.x.0, value);
            let _ = writeln!(
                out,
                r##"<line x1="{}" x2="{}" y1="{y:.1}" y2="{y:.1}" stroke="#e2e6eb"/><text x="{}" y="{:.1}" text-anchor="end">{value:.1}</text>"##,
                self.left,
                self.left + self.width,
                self.left - 6.0,
                y + 4.0
            );
        }
    }

    fn line(&self, out: &mut String, points: impl Iterator<Item = (f64, f64)>, color: &str) {
        let path: String = points
            .map(|(x, y)| self.at(x, y.clamp(self.y.0, self.y.1)))
            .map(|(x, y)| format!("{x:.1},{y:.1} "))
            .collect();
        let _ = writeln!(
            out,
            r##"<polyline points="{path}" fill="none" stroke="{color}" stroke-width="1.6"/>"##
        );
    }
}

/// Draws a report; lengths in millimetres.
#[must_use]
pub fn draw(report: &TuneReport, traces: &Traces) -> String {
    let mut out = format!(
        r##"<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="12" fill="#222"><style>.t{{font-size:14px;font-weight:bold}}</style><rect width="100%" height="100%" fill="white"/>"##
    );
    let mm = |metres: f64| 1e3 * metres;
    let first = report.cost_seen[0];
    let most = report.history.iter().copied().fold(first, f64::max);
    let generations = Panel {
        left: 60.0,
        top: 50.0,
        width: 350.0,
        height: 200.0,
        x: (0.0, report.history.len().max(1) as f64),
        y: (0.0, mm(most) * 1.1),
    };
    generations.frame(&mut out, "least cost in the rooms of the search, mm", "generation");
    let ends = [(0.0, mm(first)), (generations.x.1, mm(first))];
    generations.line(&mut out, ends.into_iter(), BEFORE);
    let history = report
        .history
        .iter()
        .enumerate()
        .map(|(index, cost)| (index as f64 + 1.0, mm(*cost)));
    generations.line(&mut out, [(0.0, mm(first))].into_iter().chain(history), AFTER);

    let costs = report
        .unseen
        .iter()
        .flat_map(|room| [room.before.cost, room.after.cost]);
    let rooms = Panel {
        left: 500.0,
        top: 50.0,
        width: 370.0,
        height: 200.0,
        x: (0.0, report.unseen.len().max(1) as f64),
        y: (0.0, mm(costs.fold(1e-3, f64::max)) * 1.1),
    };
    rooms.frame(&mut out, "cost in rooms that the search has not seen, mm", "room");
    for (index, room) in report.unseen.iter().enumerate() {
        for (offset, judged, color) in [(0.15, room.before, BEFORE), (0.5, room.after, AFTER)] {
            let (x, y) = rooms.at(index as f64 + offset, mm(judged.cost));
            let _ = writeln!(
                out,
                r##"<rect x="{x:.1}" y="{y:.1}" width="{:.1}" height="{:.1}" fill="{color}"/>"##,
                0.35 * rooms.width / rooms.x.1,
                rooms.top + rooms.height - y
            );
        }
    }

    let last = traces.iter().flatten().map(|(time, _)| *time).fold(1.0, f64::max);
    let trace = Panel {
        left: 60.0,
        top: 330.0,
        width: 810.0,
        height: 230.0,
        x: (0.0, last),
        y: (-60.0, 60.0),
    };
    let name = report.unseen.first().map_or("", |room| &room.room);
    trace.frame(
        &mut out,
        &format!("distance error over time in {name}, mm (cut off beyond 60)"),
        "simulated time, s",
    );
    for (points, color) in traces.iter().zip([BEFORE, AFTER]) {
        trace.line(&mut out, points.iter().map(|(time, error)| (*time, mm(*error))), color);
    }
    for (index, (what, color)) in [("before", BEFORE), ("after", AFTER)].into_iter().enumerate() {
        let y = HEIGHT - 24.0;
        let x = 60.0 + 110.0 * index as f64;
        let _ = writeln!(
            out,
            r##"<rect x="{x}" y="{}" width="14" height="10" fill="{color}"/><text x="{}" y="{y}">{what}</text>"##,
            y - 9.0,
            x + 20.0
        );
    }
    let _ = writeln!(
        out,
        r##"<text x="{}" y="{}" text-anchor="end">{}: {:.1} % less in unseen rooms (seed {})</text></svg>"##,
        WIDTH - 30.0,
        HEIGHT - 24.0,
        report.robot,
        100.0 * report.improvement,
        report.seed
    );
    out
}
