//! `zenav diff`. Compares two runs: goals, path, time, clearance, stages and keys, largest differences first.

use std::collections::BTreeSet;
use std::path::PathBuf;

use nalgebra::Point2;
use serde::Serialize;

use super::run::{GoalRun, KeyCount, RobotRun, Run};
use crate::exit_code;
use crate::failure::Outcome;
use crate::output::{self, Format};
use crate::report::Percentiles;

/// Most points of a path that are compared.
const POINTS: usize = 2000;
/// Number of differences listed as the largest.
const LARGEST: usize = 5;

/// Arguments of `zenav diff`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav diff monday.mcap tuesday.mcap\n  zenav diff monday.mcap tuesday.mcap -o json\n\nExit code 1 where a goal ended otherwise; whatever else differs is told, and no failure."
)]
pub struct DiffArgs {
    /// Record
    #[arg(value_name = "A.mcap")]
    a: PathBuf,
    /// Record to compare it with
    #[arg(value_name = "B.mcap")]
    b: PathBuf,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Comparison of two runs.
#[derive(Debug, Serialize)]
struct Comparison {
    /// Whether every goal ended the same way.
    same_outcomes: bool,
    robots: Vec<RobotComparison>,
    keys: Vec<Key>,
    largest: Vec<Largest>,
}

#[derive(Debug, Serialize)]
struct RobotComparison {
    robot: String,
    goals: Vec<GoalComparison>,
    figures: Vec<Figure>,
    /// Largest distance of a point of one path from the other path, m.
    path_apart_m: Option<f64>,
}

#[derive(Debug, Serialize)]
struct GoalComparison {
    goal: String,
    a: Option<&'static str>,
    b: Option<&'static str>,
    a_secs: Option<f64>,
    b_secs: Option<f64>,
}

/// A figure of both runs.
#[derive(Clone, Debug, Serialize)]
struct Figure {
    name: String,
    unit: &'static str,
    a: Option<f64>,
    b: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Key {
    key: String,
    a: u64,
    b: u64,
    a_hz: f64,
    b_hz: f64,
}

/// One of the largest differences.
#[derive(Debug, Serialize)]
struct Largest {
    what: String,
    a: f64,
    b: f64,
    /// Difference relative to the larger value, 0 to 1.
    share: f64,
}

/// `zenav diff`.
///
/// # Errors
/// A bad record.
pub fn diff(args: &DiffArgs) -> Outcome {
    let (a, b) = (Run::read(&args.a)?, Run::read(&args.b)?);
    let comparison = compare(&a, &b);
    output::value(args.output, &comparison, table)?;
    Ok(if comparison.same_outcomes {
        exit_code::OK
    } else {
        exit_code::FAILED
    })
}

fn compare(a: &Run, b: &Run) -> Comparison {
    let names: BTreeSet<&String> = a.robots.keys().chain(b.robots.keys()).collect();
    let nobody = RobotRun::default();
    let robots: Vec<RobotComparison> = names
        .into_iter()
        .map(|name| {
            let (of_a, of_b) = (a.robots.get(name), b.robots.get(name));
            let (ra, rb) = (of_a.unwrap_or(&nobody), of_b.unwrap_or(&nobody));
            RobotComparison {
                robot: name.clone(),
                goals: goals(ra, rb),
                figures: figures(of_a, of_b),
                path_apart_m: apart(ra, rb),
            }
        })
        .collect();
    let keys = keys(a, b);
    let mut largest: Vec<Largest> = Vec::new();
    for robot in &robots {
        for figure in &robot.figures {
            largest.extend(share(&format!("{} {}", robot.robot, figure.name), figure.a, figure.b));
        }
    }
    for key in &keys {
        largest.extend(share(&format!("{} Hz", key.key), Some(key.a_hz), Some(key.b_hz)));
    }
    largest.sort_by(|x, y| y.share.total_cmp(&x.share));
    largest.truncate(LARGEST);
    Comparison {
        same_outcomes: robots
            .iter()
            .flat_map(|robot| &robot.goals)
            .all(|goal| goal.a == goal.b),
        robots,
        keys,
        largest,
    }
}

fn share(what: &str, a: Option<f64>, b: Option<f64>) -> Option<Largest> {
    let (a, b) = (a?, b?);
    let greater = a.abs().max(b.abs());
    let share = (a - b).abs() / greater;
    (share.is_finite() && share > 1e-9).then(|| Largest {
        what: what.to_owned(),
        a,
        b,
        share,
    })
}

/// Pairs goals by id; the remaining ones by order of arrival, as ids are often generated anew.
fn goals(a: &RobotRun, b: &RobotRun) -> Vec<GoalComparison> {
    fn left<'r>(of: &'r RobotRun, other: &RobotRun) -> Vec<&'r GoalRun> {
        let mut left: Vec<&GoalRun> = of
            .goals
            .iter()
            .filter(|(id, _)| !other.goals.contains_key(*id))
            .map(|(_, goal)| goal)
            .collect();
        left.sort_by(|x, y| x.from.total_cmp(&y.from));
        left
    }
    let row = |goal: String, a: Option<&GoalRun>, b: Option<&GoalRun>| GoalComparison {
        goal,
        a: a.map(|goal| goal.state.state.name()),
        b: b.map(|goal| goal.state.state.name()),
        a_secs: a.map(|goal| goal.to - goal.from),
        b_secs: b.map(|goal| goal.to - goal.from),
    };
    let mut rows: Vec<GoalComparison> = a
        .goals
        .iter()
        .filter_map(|(id, goal)| Some(row(id.clone(), Some(goal), Some(b.goals.get(id)?))))
        .collect();
    let (only_a, only_b) = (left(a, b), left(b, a));
    for nth in 0..only_a.len().max(only_b.len()) {
        let (goal_a, goal_b) = (only_a.get(nth).copied(), only_b.get(nth).copied());
        let ids = [goal_a, goal_b].map(|goal| goal.map_or("-", |goal| goal.state.id.as_str()));
        rows.push(row(ids.join(" / "), goal_a, goal_b));
    }
    rows
}

fn figures(a: Option<&RobotRun>, b: Option<&RobotRun>) -> Vec<Figure> {
    let figure = |name: &str, unit, of: &dyn Fn(&RobotRun) -> Option<f64>| Figure {
        name: name.to_owned(),
        unit,
        a: a.and_then(of),
        b: b.and_then(of),
    };
    let mut figures = vec![
        figure("path", "m", &|run| Some(run.length)),
        figure("time", "s", &|run| Some(run.secs)),
        figure("mean speed", "m/s", &RobotRun::mean_speed),
        figure("top speed", "m/s", &|run| Some(run.top_speed())),
        figure("least clearance", "m", &RobotRun::least_clearance),
        figure("plans", "", &|run| Some(run.plans as f64)),
        figure("plans refused", "", &|run| Some(run.rejected as f64)),
        figure("bumps", "", &|run| Some(run.bumps as f64)),
    ];
    let names: BTreeSet<&str> = [a, b]
        .into_iter()
        .flatten()
        .flat_map(|run| run.stages.keys().copied())
        .collect();
    for name in names {
        let of = |run: &RobotRun| run.stages.get(name).map(|samples| Percentiles::of(samples));
        figures.push(figure(&format!("{name}, median"), "ms", &|run| of(run)?.p50));
        figures.push(figure(&format!("{name}, p99"), "ms", &|run| of(run)?.p99));
    }
    figures
}

fn keys(a: &Run, b: &Run) -> Vec<Key> {
    let names: BTreeSet<&String> = a.keys.keys().chain(b.keys.keys()).collect();
    let hz = |count: KeyCount, run: &Run| count.messages as f64 / run.wall_secs.max(1e-3);
    names
        .into_iter()
        .map(|key| {
            let of = |run: &Run| run.keys.get(key).copied().unwrap_or_default();
            Key {
                key: key.clone(),
                a: of(a).messages,
                b: of(b).messages,
                a_hz: hz(of(a), a),
                b_hz: hz(of(b), b),
            }
        })
        .collect()
}

/// Largest distance of a point of one path from the nearest point of the other, m.
fn apart(a: &RobotRun, b: &RobotRun) -> Option<f64> {
    let thinned = |run: &RobotRun| -> Vec<Point2<f64>> {
        let step = run.poses.len().div_ceil(POINTS).max(1);
        run.poses
            .iter()
            .step_by(step)
            .map(|(_, pose)| pose.position())
            .collect()
    };
    let (a, b) = (thinned(a), thinned(b));
    let farthest = |from: &[Point2<f64>], to: &[Point2<f64>]| {
        let nearest = |point: &Point2<f64>| to.iter().map(|other| (other - point).norm_squared()).reduce(f64::min);
        from.iter().filter_map(nearest).reduce(f64::max)
    };
    Some(farthest(&a, &b)?.max(farthest(&b, &a)?).sqrt())
}

fn number(value: Option<f64>) -> String {
    match value {
        None => "-".to_owned(),
        Some(value) if value.fract() == 0.0 && value.abs() < 1e9 => format!("{value:.0}"),
        Some(value) if value.abs() >= 100.0 => format!("{value:.1}"),
        Some(value) => format!("{value:.3}"),
    }
}

fn table(comparison: &Comparison) -> String {
    let mut lines = Vec::new();
    for robot in &comparison.robots {
        let mut rows: Vec<[String; 4]> = Vec::new();
        for goal in &robot.goals {
            let told = |phase: Option<&str>, secs: Option<f64>| match (phase, secs) {
                (Some(phase), Some(secs)) => format!("{phase}, {secs:.1} s"),
                _ => "-".to_owned(),
            };
            let mark = if goal.a == goal.b { "" } else { "other outcome" };
            rows.push([
                format!("goal {}", goal.goal),
                told(goal.a, goal.a_secs),
                told(goal.b, goal.b_secs),
                mark.to_owned(),
            ]);
        }
        for figure in &robot.figures {
            let name = if figure.unit.is_empty() {
                figure.name.clone()
            } else {
                format!("{}, {}", figure.name, figure.unit)
            };
            let change = figure.a.zip(figure.b).map(|(a, b)| {
                let sign = if b > a { "+" } else { "" };
                format!("{sign}{}", number(Some(b - a)))
            });
            rows.push([name, number(figure.a), number(figure.b), change.unwrap_or_default()]);
        }
        if let Some(apart) = robot.path_apart_m {
            rows.push([
                "paths apart at most, m".to_owned(),
                String::new(),
                String::new(),
                number(Some(apart)),
            ]);
        }
        lines.push(output::table(&[&robot.robot.to_uppercase(), "A", "B", "B - A"], rows));
        lines.push(String::new());
    }
    let rows = comparison.keys.iter().map(|key| {
        let [a_hz, b_hz] = [key.a_hz, key.b_hz].map(|hz| format!("{hz:.1}"));
        [key.key.clone(), key.a.to_string(), key.b.to_string(), a_hz, b_hz]
    });
    lines.push(output::table(&["KEY", "A", "B", "A HZ", "B HZ"], rows));
    lines.push(String::new());
    for largest in &comparison.largest {
        lines.push(format!(
            "largest: {} {} against {} ({:.0} %)",
            largest.what,
            number(Some(largest.a)),
            number(Some(largest.b)),
            100.0 * largest.share
        ));
    }
    let verdict = if comparison.same_outcomes {
        "every goal ended alike"
    } else {
        "goals ended otherwise"
    };
    lines.push(verdict.to_owned());
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Pose2;

    use super::*;

    fn driven(offset: f64) -> RobotRun {
        RobotRun {
            poses: (0..100)
                .map(|nth| (0.1 * f64::from(nth), Pose2::new(0.1 * f64::from(nth), offset, 0.0)))
                .collect(),
            length: 9.9,
            secs: 9.9 + offset,
            ..RobotRun::default()
        }
    }

    fn run(robot: RobotRun) -> Run {
        Run {
            robots: [("r".to_owned(), robot)].into(),
            wall_secs: 10.0,
            keys: [(
                "zenav/r/edge/pose".to_owned(),
                KeyCount {
                    messages: 500,
                    bytes: 1,
                },
            )]
            .into(),
            ..Run::default()
        }
    }

    #[test]
    fn a_run_does_not_differ_from_itself() {
        let comparison = compare(&run(driven(0.0)), &run(driven(0.0)));
        assert!(comparison.same_outcomes && comparison.largest.is_empty());
        assert_eq!(comparison.robots[0].path_apart_m, Some(0.0));
    }

    #[test]
    fn what_differs_most_comes_first() {
        let mut other = run(driven(0.5));
        other.keys.values_mut().for_each(|count| count.messages = 100);
        let comparison = compare(&run(driven(0.0)), &other);
        assert!((comparison.robots[0].path_apart_m.unwrap() - 0.5).abs() < 1e-9);
        assert_eq!(comparison.largest[0].what, "zenav/r/edge/pose Hz");
        assert!((comparison.largest[0].share - 0.8).abs() < 1e-9);
        assert!(table(&comparison).contains("every goal ended alike"));
    }
}
