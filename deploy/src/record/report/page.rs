//! Page. Layout and style of the report: one HTML file, light or dark as set in the reader's system.

use std::fmt::Write as _;

use time::OffsetDateTime;
use zenav_protocol::messages::GoalPhase;

use super::super::run::{GoalRun, KeyCount, RobotRun, Run};
use super::{chart, floor};
use crate::failure::Failure;
use crate::goal::target;
use crate::output::{counted, escape, piece};
use crate::report::Percentiles;

/// Most events on the page.
const MOST_EVENTS: usize = 500;
/// Events visible without a click.
const SHOWN_EVENTS: usize = 12;

const STYLE: &str = r"
:root { color-scheme: light dark; --ink: #1d2228; --soft: #667080; --line: #dfe3e8; --paper: #ffffff; --card: #f6f7f9; --accent: #2266d0;
  --good: #1e824c; --bad: #c8402c; --warn: #955800; --floor: #d6dade; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ee; --soft: #98a2b0; --line: #333a43; --paper: #15181c; --card: #1d2126;
  --accent: #6aa2ff; --good: #58c08a; --bad: #ff7a66; --warn: #e0a040; --floor: #2b3036; } image { filter: invert(0.86); } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 920px; padding: 2.5rem 1.25rem 4rem; background: var(--paper); color: var(--ink);
  font: 15px/1.55 system-ui, -apple-system, 'Segoe UI', sans-serif; font-variant-numeric: tabular-nums; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0 0 .2rem; font-weight: 650; letter-spacing: -.01em; }
h2 { font-size: 1.15rem; margin: 2.6rem 0 .6rem; font-weight: 650; }
h3 { font-size: .82rem; margin: 1.8rem 0 .4rem; font-weight: 600; color: var(--soft); text-transform: uppercase; letter-spacing: .06em; }
p { margin: .3rem 0; } .soft { color: var(--soft); }
.figures { display: grid; grid-template-columns: repeat(4, 1fr); gap: 1px; margin: 1.2rem 0; background: var(--line);
  border: 1px solid var(--line); border-radius: 8px; overflow: hidden; }
.figures div { background: var(--paper); padding: .7rem .9rem; } .figures b { display: block; font-size: 1.25rem; font-weight: 600; }
.figures span { color: var(--soft); font-size: .8rem; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; } th { text-align: left; font-weight: 600; color: var(--soft); font-size: .8rem; }
th, td { padding: .34rem .8rem .34rem 0; border-bottom: 1px solid var(--line); vertical-align: top; } .n { text-align: right; }
td.leg { padding-left: 1.2rem; } .good { color: var(--good); } .bad { color: var(--bad); } .warn { color: var(--warn); }
.wide { overflow-x: auto; } svg { display: block; width: 100%; height: auto; } svg text { fill: var(--soft); font-size: 11px; }
.floor { background: var(--floor); border-radius: 8px; max-height: 620px; } .floor text.name { fill: var(--ink); stroke: var(--paper); stroke-width: .2em; paint-order: stroke; }
.floor image { image-rendering: pixelated; } .floor .path { fill: none; stroke: var(--bad); stroke-linejoin: round; stroke-linecap: round; }
.floor .plan { fill: none; stroke: var(--good); opacity: .8; } .floor .start { fill: #7a3cb0; } .floor .goal { fill: #f09600; }
.floor .robot { fill: var(--accent); fill-opacity: .35; stroke: var(--accent); } .floor .bar { stroke: var(--ink); }
.chart .grid { stroke: var(--line); stroke-width: 1; } .chart .curve { fill: none; stroke: var(--accent); stroke-width: 1.6; stroke-linejoin: round; }
.chart .mark { stroke: var(--warn); stroke-width: 1; stroke-dasharray: 2 3; } rect { rx: 2px; } .success { fill: var(--good); }
.failure { fill: var(--bad); } .running { fill: var(--accent); } .halted { fill: var(--soft); opacity: .55; }
details > summary { cursor: pointer; color: var(--accent); padding: .4rem 0; } footer { margin-top: 3rem; color: var(--soft); font-size: .82rem; }
@media (max-width: 560px) { .figures { grid-template-columns: repeat(2, 1fr); } }
@media print { body { max-width: none; } }
";

/// The page of a run.
///
/// # Errors
/// The image of a map cannot be made.
pub fn html(run: &Run) -> Result<String, Failure> {
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n<p class=\"soft\">{date}{:.1} s recorded &middot; \
         {} messages on {} keys{}{}</p>\n",
        run.wall_secs,
        run.keys.values().map(|count| count.messages).sum::<u64>(),
        run.keys.len(),
        if run.cut_off {
            " &middot; the record was cut off"
        } else {
            ""
        },
        match run.damaged_chunks {
            0 => String::new(),
            chunks => format!(" &middot; {} left out", counted(chunks, "damaged chunk")),
        },
        title = escape(&run.title),
        date = date(run.began).map_or_else(String::new, |date| format!("{date} UTC &middot; ")),
    );
    for (name, robot) in &run.robots {
        section(name, robot, &mut page)?;
    }
    keys(run, &mut page);
    let _ = write!(
        page,
        "<footer>zenav {}. Speed and path are the robot&rsquo;s own estimate; clearance is from its outline to the nearest return of its lidar; \
         latencies are wall time at the recorder; what a node or a search took is as its component told.</footer>\n</main>\n</body>\n</html>\n",
        env!("CARGO_PKG_VERSION")
    );
    Ok(page)
}

fn section(name: &str, robot: &RobotRun, page: &mut String) -> Result<(), Failure> {
    let _ = writeln!(page, "<h2>{}</h2>", escape(name));
    figures(robot, page);
    let floor = floor::svg(robot)?;
    if !floor.is_empty() {
        let _ = writeln!(
            page,
            "{floor}\n<p class=\"soft\">Red: driven; green: the last plan; violet: start; orange: goals.</p>"
        );
    }
    goals(robot, page);
    let marks: Vec<f64> = robot
        .events
        .iter()
        .filter(|(_, is_warning, _)| *is_warning)
        .map(|(time, _, _)| *time)
        .take(200)
        .collect();
    for (title, series) in [("Speed, m/s", &robot.speed), ("Clearance, m", &robot.clearance)] {
        if !series.is_empty() {
            let chart = chart::line(series, robot.secs, &marks, title);
            let _ = writeln!(page, "<h3>{title}</h3>\n{chart}");
        }
    }
    if !marks.is_empty() && !robot.speed.is_empty() {
        page.push_str("<p class=\"soft\">Dotted: warnings, listed below.</p>\n");
    }
    if !robot.nodes.is_empty() {
        let timeline = chart::timeline(&robot.nodes, robot.secs);
        let _ = writeln!(
            page,
            "<h3>Behaviour tree</h3>\n<div class=\"wide\">{timeline}</div>\n<p class=\"soft\">Green: succeeded; red: failed; blue: \
             running when the record ended; grey: halted, or its result is not in the record.</p>"
        );
    }
    stages(robot, page);
    events(robot, page);
    Ok(())
}

fn figures(robot: &RobotRun, page: &mut String) {
    let metres = |value: Option<f64>| value.map_or_else(|| "&ndash;".to_owned(), |value| format!("{value:.2} m"));
    let mean = robot.mean_speed().unwrap_or(0.0);
    let refused = match robot.rejected {
        0 => String::new(),
        count => format!(" ({count} refused)"),
    };
    let is_reached = |goal: &&GoalRun| goal.state.state == GoalPhase::Succeeded;
    let reached = robot.goals.values().filter(is_reached).count();
    let figures = [
        (format!("{reached} of {}", robot.goals.len()), "goals reached"),
        (format!("{:.1} s", robot.secs), "time"),
        (format!("{:.2} m", robot.length), "driven"),
        (format!("{mean:.2} m/s"), "mean speed"),
        (format!("{:.2} m/s", robot.top_speed()), "top speed"),
        (metres(robot.least_clearance()), "least clearance"),
        (format!("{}{refused}", robot.plans), "plans"),
        (robot.bumps.to_string(), "bumps"),
    ];
    page.push_str("<div class=\"figures\">");
    for (value, name) in figures {
        let _ = write!(page, "<div><b>{value}</b><span>{name}</span></div>");
    }
    page.push_str("</div>\n");
}

fn goals(robot: &RobotRun, page: &mut String) {
    if robot.goals.is_empty() {
        return;
    }
    let row = |name: String, phase: GoalPhase, reason: Option<&str>, figures: [String; 4]| {
        let reason = piece(reason, |reason| format!(": {}", escape(reason)));
        let outcome = format!("<td class=\"{}\">{}{reason}</td>", class(phase), phase.name());
        format!("<tr>{name}{outcome}{}</tr>\n", numbers(&figures))
    };
    let mut goals: Vec<_> = robot.goals.values().collect();
    goals.sort_by(|a, b| a.from.total_cmp(&b.from));
    let mut rows = String::new();
    for goal in goals {
        let state = &goal.state;
        let (target, id) = (escape(&target(&state.request)), escape(&state.id));
        rows += &row(
            format!("<td>{target} <span class=\"soft\">{id}</span></td>"),
            state.state,
            state.reason.as_deref(),
            [
                format!("{:.1}", goal.to - goal.from),
                format!("{:.2}", goal.length),
                state.feedback.plans.to_string(),
                state.feedback.replans.to_string(),
            ],
        );
        for leg in &state.legs {
            let time = piece(leg.ended, |ended| format!("{:.1}", ended.secs_since(leg.started)));
            rows += &row(
                format!("<td class=\"leg\">{}</td>", escape(&leg.name)),
                leg.state,
                leg.reason.as_deref(),
                [time, String::new(), leg.plans.to_string(), leg.replans.to_string()],
            );
        }
    }
    let table = table(
        &["Goal", "Outcome"],
        &["Time, s", "Driven, m", "Plans", "Replans"],
        &rows,
    );
    let _ = writeln!(page, "<h3>Goals</h3>\n{table}");
}

/// A table with columns of words, then of numbers.
fn table(words: &[&str], numbers: &[&str], rows: &str) -> String {
    let words = words.iter().map(|name| format!("<th>{name}</th>"));
    let numbers = numbers.iter().map(|name| format!("<th class=\"n\">{name}</th>"));
    let header: String = words.chain(numbers).collect();
    format!("<div class=\"wide\"><table><tr>{header}</tr>\n{rows}</table></div>")
}

/// Cells of numbers.
fn numbers(cells: &[String]) -> String {
    cells
        .iter()
        .map(|cell| format!("<td class=\"n\">{cell}</td>"))
        .collect()
}

const fn class(phase: GoalPhase) -> &'static str {
    match phase {
        GoalPhase::Succeeded => "good",
        GoalPhase::Aborted | GoalPhase::Rejected => "bad",
        GoalPhase::Canceled => "warn",
        _ => "",
    }
}

fn stages(robot: &RobotRun, page: &mut String) {
    if robot.stages.is_empty() {
        return;
    }
    let row = |(name, samples): (&&str, &Vec<f64>)| {
        let Percentiles { p50, p99 } = Percentiles::of(samples);
        let longest = samples.iter().copied().fold(0.0, f64::max);
        let [p50, p99, longest] = [p50, p99, Some(longest)].map(|ms| piece(ms, |ms| format!("{ms:.1}")));
        let figures = numbers(&[p50, p99, longest, samples.len().to_string()]);
        format!("<tr><td>{name}</td>{figures}</tr>\n")
    };
    let rows: String = robot.stages.iter().map(row).collect();
    let table = table(&["Stage"], &["Median", "p99", "Longest", "Samples"], &rows);
    let _ = writeln!(page, "<h3>Latency of stages, ms</h3>\n{table}");
}

fn events(robot: &RobotRun, page: &mut String) {
    if robot.events.is_empty() {
        return;
    }
    page.push_str("<h3>Events, newest first</h3>\n");
    // Newest first, from the end: readers look first for how a run ended.
    let rows: Vec<String> = robot
        .events
        .iter()
        .rev()
        .take(MOST_EVENTS)
        .map(|(time, is_warning, text)| {
            let class = if *is_warning { " class=\"warn\"" } else { "" };
            format!(
                "<tr><td class=\"n\">{time:.1} s</td><td{class}>{}</td></tr>\n",
                escape(text)
            )
        })
        .collect();
    let (shown, hidden) = rows.split_at(rows.len().min(SHOWN_EVENTS));
    let _ = writeln!(page, "<div class=\"wide\"><table>{}</table></div>", shown.concat());
    if !hidden.is_empty() {
        let older = robot.events.len() - rows.len();
        let left_out = match older {
            0 => String::new(),
            older => format!(", and {older} older ones that are left out"),
        };
        let _ = writeln!(
            page,
            "<details><summary>{} more{left_out}</summary><div class=\"wide\"><table>{}</table></div></details>",
            hidden.len(),
            hidden.concat()
        );
    }
}

fn keys(run: &Run, page: &mut String) {
    let row = |(key, count): (&String, &KeyCount)| {
        let hz = count.messages as f64 / run.wall_secs.max(1e-3);
        let figures = numbers(&[
            count.messages.to_string(),
            format!("{hz:.1}"),
            format!("{:.1}", count.bytes as f64 * 1e-3),
        ]);
        format!("<tr><td>{}</td>{figures}</tr>\n", escape(key))
    };
    let rows: String = run.keys.iter().map(row).collect();
    let table = table(&["Key"], &["Messages", "Hz", "kB"], &rows);
    let summary = format!("<summary>{} keys</summary>", run.keys.len());
    let _ = writeln!(page, "<h2>Record</h2>\n<details>{summary}{table}</details>");
}

/// Day and time of a UNIX time in ns, such as `2026-03-01 14:05`. `None` in the first year: simulated time, which begins at zero.
fn date(nanos: u64) -> Option<String> {
    let time = OffsetDateTime::from_unix_timestamp_nanos(nanos.into()).ok()?;
    let (year, month, day) = time.to_calendar_date();
    let (hour, minute, _) = time.to_hms();
    (year > 1970).then(|| format!("{year:04}-{:02}-{day:02} {hour:02}:{minute:02}", u8::from(month)))
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Pose2;

    use super::*;

    #[test]
    fn dates_are_right_and_simulated_time_has_none() {
        assert_eq!(date(20_000_000), None);
        assert_eq!(date(951_827_696_000_000_000).unwrap(), "2000-02-29 12:34");
        assert_eq!(date(1_798_761_599_000_000_000).unwrap(), "2026-12-31 23:59");
    }

    #[test]
    fn a_page_needs_nothing_from_elsewhere_and_takes_no_code_from_a_name() {
        let robot = RobotRun {
            poses: vec![(0.0, Pose2::IDENTITY), (1.0, Pose2::new(2.0, 1.0, 0.0))],
            speed: vec![(0.0, 0.0), (1.0, 0.5)],
            events: vec![(0.5, true, "<script>alert(1)</script>".to_owned()); 20],
            secs: 1.0,
            ..RobotRun::default()
        };
        let run = Run {
            title: "a & \"b\"".to_owned(),
            robots: [("<r>".to_owned(), robot)].into(),
            ..Run::default()
        };
        let page = html(&run).unwrap();
        assert!(page.contains("a &amp; &quot;b&quot;") && page.contains("&lt;r&gt;"));
        for outside in ["<script", "http://", "https://", "src=", "@import", "url("] {
            assert!(!page.contains(outside), "{outside}");
        }
        assert!(page.contains("8 more") && page.contains("prefers-color-scheme: dark"));
    }
}
