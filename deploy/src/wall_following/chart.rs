//! Chart of a search. An SVG of the cost by generation, each unseen room before and after, and the distance error over time in one of
//! them.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::tune::{Traces, TuneReport};
use crate::failure::Failure;

/// Size of the picture, px.
const SIZE: (u32, u32) = (900, 640);
const UPPER: i32 = 290;
const BEFORE: RGBColor = RGBColor(154, 164, 178);
const AFTER: RGBColor = RGBColor(31, 111, 208);
/// Errors beyond this are clipped, mm.
const MOST: f64 = 60.0;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Draws a report; lengths in millimetres.
///
/// # Errors
/// The chart cannot be drawn.
pub fn draw(report: &TuneReport, traces: &Traces) -> Result<String, Failure> {
    let mut text = String::new();
    paint(&mut text, report, traces).map_err(|error| Failure::failed(format!("the chart: {error}")))?;
    Ok(text)
}

type Painted = Result<(), Box<dyn std::error::Error>>;

fn paint(text: &mut String, report: &TuneReport, traces: &Traces) -> Painted {
    let root = SVGBackend::with_string(text, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!(
        "{}: {:.1} % less in unseen rooms (seed {})",
        report.robot,
        100.0 * report.improvement,
        report.seed
    );
    let root = root.titled(&title, ("sans-serif", 18))?;
    let (upper, lower) = root.split_vertically(UPPER);
    let (left, right) = upper.split_horizontally(SIZE.0 as i32 / 2);
    generations(&left, report)?;
    rooms(&right, report)?;
    errors(&lower, report, traces)?;
    root.present()?;
    Ok(())
}

fn mm(metres: f64) -> f64 {
    1e3 * metres
}

/// A chart with this caption, and space for the labels of its axes.
fn chart<'a, 'b>(area: &'a Area<'b>, caption: &str) -> ChartBuilder<'a, 'static, SVGBackend<'b>> {
    let mut chart = ChartBuilder::on(area);
    chart.caption(caption, ("sans-serif", 14)).margin(12);
    chart.x_label_area_size(34).y_label_area_size(48);
    chart
}

fn generations(area: &Area<'_>, report: &TuneReport) -> Painted {
    let first = report.cost_seen[0];
    let most = report.history.iter().copied().fold(first, f64::max);
    let last = report.history.len().max(1) as f64;
    let mut chart =
        chart(area, "least cost in the rooms of the search").build_cartesian_2d(0.0..last, 0.0..mm(most) * 1.1)?;
    chart.configure_mesh().x_desc("generation").y_desc("mm").draw()?;
    chart.draw_series(LineSeries::new([(0.0, mm(first)), (last, mm(first))], &BEFORE))?;
    let costs = report.history.iter().enumerate();
    let costs = costs.map(|(index, cost)| (index as f64 + 1.0, mm(*cost)));
    let line = LineSeries::new([(0.0, mm(first))].into_iter().chain(costs), AFTER.stroke_width(2));
    chart.draw_series(line)?;
    Ok(())
}

fn rooms(area: &Area<'_>, report: &TuneReport) -> Painted {
    let costs = report
        .unseen
        .iter()
        .flat_map(|room| [room.before.cost, room.after.cost]);
    let most = mm(costs.fold(1e-3, f64::max)) * 1.1;
    let mut chart = chart(area, "cost in rooms that the search has not seen")
        .build_cartesian_2d(0.5..report.unseen.len().max(1) as f64 + 0.5, 0.0..most)?;
    let mut mesh = chart.configure_mesh();
    mesh.x_desc("room").y_desc("mm").disable_x_mesh().draw()?;
    for (offset, color) in [(-0.35, BEFORE), (0.0, AFTER)] {
        let bars = report.unseen.iter().enumerate().map(|(index, room)| {
            let cost = if color == BEFORE {
                room.before.cost
            } else {
                room.after.cost
            };
            let left = index as f64 + 1.0 + offset;
            Rectangle::new([(left, 0.0), (left + 0.35, mm(cost))], color.filled())
        });
        chart.draw_series(bars)?;
    }
    Ok(())
}

fn errors(area: &Area<'_>, report: &TuneReport, traces: &Traces) -> Painted {
    let last = traces.iter().flatten().map(|(time, _)| *time).fold(1.0, f64::max);
    let name = report.unseen.first().map_or("", |room| &room.room);
    let caption = format!("distance error over time in {name} (cut off beyond {MOST} mm)");
    let mut chart = chart(area, &caption).build_cartesian_2d(0.0..last, -MOST..MOST)?;
    chart.configure_mesh().x_desc("simulated time, s").y_desc("mm").draw()?;
    for ((points, color), name) in traces.iter().zip([BEFORE, AFTER]).zip(["before", "after"]) {
        let points = points
            .iter()
            .map(|(time, error)| (*time, mm(*error).clamp(-MOST, MOST)));
        let key = move |(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(2));
        chart
            .draw_series(LineSeries::new(points, &color))?
            .label(name)
            .legend(key);
    }
    let mut labels = chart.configure_series_labels();
    labels.background_style(WHITE.mix(0.8)).border_style(BEFORE).draw()?;
    Ok(())
}
