//! Report of a scenario. Its result from the simulator's ground truth, for people and programs.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;
use zenav_protocol::messages::GoalPoint;
use zenav_sim::Truth;

use crate::output::{counted, piece, table};
use crate::wall_following::score::Kept;

/// Outcome of a scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ScenarioOutcome {
    /// Every goal was reached without a collision.
    Succeeded,
    /// Anything else.
    Failed,
}

/// Report of `zenav demo`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DemoReport {
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of all noise.
    pub seed: u64,
    /// Requested simulated seconds per second of wall time.
    pub speed: f64,
    /// Outcome.
    pub outcome: ScenarioOutcome,
    /// Reason of a failure.
    pub reason: Option<String>,
    /// Whether a stored map was found, so that mapping was skipped.
    pub map_found: bool,
    /// Every drive, in order.
    pub goals: Vec<GoalReport>,
    /// Unreachable goals that were submitted, and correctly refused.
    pub refused: Vec<RefusedGoal>,
    /// Contacts of the robot.
    pub collisions: u64,
    /// Smallest distance of the footprint to an obstacle over the whole run, m.
    pub min_clearance_m: f64,
    /// Simulated time, s.
    pub sim_time_s: f64,
    /// Wall time of the run, s.
    pub wall_time_s: f64,
    /// Plans published.
    pub plans: u64,
    /// Plans that replaced another one during a drive.
    pub replans: u64,
    /// Wall-clock latencies.
    pub latency: Latency,
    /// Energy drawn, J.
    pub energy_j: f64,
    /// Energy drawn per metre driven, J/m; `None` for hardly any distance.
    pub energy_per_m: Option<f64>,
    /// Results of wall following, if the robot followed walls.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub walls: Option<WallReport>,
    /// Limits of validity at this simulation speed.
    pub notes: Vec<String>,
    /// Files written.
    pub files: Vec<PathBuf>,
}

/// Results of wall following: distances from the simulator's ground truth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WallReport {
    /// Target distance, m.
    pub target_m: f64,
    /// Accuracy of the distance.
    #[serde(flatten)]
    pub kept: Kept,
    /// Contacts reported by the bumper.
    pub bumps: u64,
    /// Path driven, m.
    pub driven_m: f64,
    /// Share of the time spent along walls.
    pub following: f64,
    /// Transitions of the state machine, with their counts.
    pub transitions: BTreeMap<String, u64>,
    /// Whether the event log has every event of the run, and each transition starts where the previous one ended.
    pub complete: bool,
    /// Late control ticks.
    pub missed_ticks: u64,
}

impl WallReport {
    fn text(&self) -> String {
        let kept = &self.kept;
        let metres = |value: f64| format!("{value:.4}");
        let mut rows = vec![
            ("distance to keep, m", format!("{:.3}", self.target_m)),
            ("error on straight walls, p95, m", metres(kept.straight_p95_m)),
            ("error on straight walls, greatest, m", metres(kept.straight_max_m)),
            ("error on straight walls, mean, m", metres(kept.straight_mean_m)),
            ("error along walls and corners, rms, m", metres(kept.rms_m)),
            (
                "samples, on straight walls and all",
                format!("{} {}", kept.straight_samples, kept.samples),
            ),
            ("bumps", self.bumps.to_string()),
            ("driven, m", format!("{:.1}", self.driven_m)),
            ("time along walls, %", format!("{:.1}", 100.0 * self.following)),
            (
                "event log",
                if self.complete { "complete" } else { "has gaps" }.to_owned(),
            ),
            ("control ticks missed", self.missed_ticks.to_string()),
        ];
        let transitions = self.transitions.iter();
        rows.extend(transitions.map(|(name, count)| (name.as_str(), count.to_string())));
        let rows = rows.into_iter().map(|(what, value)| [what.to_owned(), value]);
        table(&["WHAT", "VALUE"], rows)
    }
}

/// A refused goal.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RefusedGoal {
    /// Description of the place.
    pub name: String,
    /// Map x, m.
    pub x: f64,
    /// Map y, m.
    pub y: f64,
    /// Reason of the refusal.
    pub reason: String,
    /// The nearest known place where the robot fits.
    pub nearest_free: Option<GoalPoint>,
}

/// One drive. Length, clearance and error are from the simulator's ground truth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GoalReport {
    /// Name in the mission.
    pub name: String,
    /// `reached`, or the reason of the failure.
    pub outcome: String,
    /// Simulated time, s.
    pub time_s: f64,
    /// Driven, m.
    pub length_m: f64,
    /// Smallest distance of the footprint to an obstacle, m.
    pub min_clearance_m: f64,
    /// Distance from the goal at the end, m; `None` for a drive without a goal of its own.
    pub final_error_m: Option<f64>,
    /// Energy drawn, J.
    pub energy_j: f64,
    /// Energy drawn per metre driven, J/m; `None` for hardly any distance.
    pub energy_per_m: Option<f64>,
}

/// Energy per metre of path, J/m; `None` if the path is too short.
#[must_use]
pub fn per_metre(joules: f64, metres: f64) -> Option<f64> {
    (metres >= ENOUGH_WAY).then(|| joules / metres)
}

/// Energy drawn, and per metre if known, in words.
#[must_use]
pub fn energy(joules: f64, per_metre: Option<f64>) -> String {
    let per_metre = piece(per_metre, |energy| format!(" ({energy:.0} J/m)"));
    format!("{joules:.0} J{per_metre}")
}

/// Least clearance, m, in words; infinite if there were no obstacles.
#[must_use]
pub fn least_clearance(metres: f64) -> String {
    if metres.is_finite() {
        format!("least clearance {metres:.3} m")
    } else {
        "no obstacle in reach".to_owned()
    }
}

/// Outcome of a reached goal.
pub const REACHED: &str = "reached";
/// Below this distance the energy per metre is meaningless, m.
const ENOUGH_WAY: f64 = 0.1;

impl GoalReport {
    /// Reason why it was not reached.
    fn failure(&self) -> Option<&str> {
        (self.outcome != REACHED).then_some(&self.outcome)
    }
}

/// Wall-clock latencies.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Latency {
    /// From the arrival of the scan or pose that a plan is based on to the plan's arrival.
    pub scan_to_plan_ms: Percentiles,
    /// From the start of a drive (its planning) to the robot's first motion.
    pub goal_to_motion_ms: Percentiles,
}

/// Median and 99th percentile; `None` without measurements.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: Option<f64>,
    /// 99th percentile (nearest rank).
    pub p99: Option<f64>,
}

impl Percentiles {
    /// Percentiles of samples in any order.
    #[must_use]
    pub fn of(samples: &[f64]) -> Self {
        let mut sorted = samples.to_vec();
        sorted.sort_by(f64::total_cmp);
        let rank = |share: f64| {
            let index = (share * sorted.len() as f64).ceil() as usize;
            sorted.get(index.saturating_sub(1)).copied()
        };
        Self {
            p50: rank(0.5),
            p99: rank(0.99),
        }
    }
}

/// A number with so many decimals; `-` for `None`.
fn short(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
}

impl DemoReport {
    /// A report from the ground truth of a scenario; it succeeded unless there is a `reason`.
    #[must_use]
    pub fn new(scenario: &str, seed: u64, speed: f64, truth: &Truth, sim_time_s: f64, reason: Option<String>) -> Self {
        Self {
            scenario: scenario.to_owned(),
            seed,
            speed,
            outcome: match reason {
                None => ScenarioOutcome::Succeeded,
                Some(_) => ScenarioOutcome::Failed,
            },
            reason,
            map_found: false,
            goals: Vec::new(),
            refused: Vec::new(),
            collisions: truth.collisions.into(),
            min_clearance_m: truth.min_clearance,
            sim_time_s,
            wall_time_s: 0.0,
            plans: 0,
            replans: 0,
            latency: Latency::default(),
            energy_j: truth.drawn_j,
            energy_per_m: per_metre(truth.drawn_j, truth.length),
            walls: None,
            notes: Vec::new(),
            files: Vec::new(),
        }
    }

    /// Marks the scenario as failed, for a reason other than its drives.
    pub fn fail(&mut self, why: String) {
        self.outcome = ScenarioOutcome::Failed;
        self.reason.get_or_insert(why);
    }

    /// The report as text.
    #[must_use]
    pub fn text(&self) -> String {
        let row = |goal: &GoalReport| {
            // The reason is printed below the table: it is longer than a column.
            let outcome = goal.failure().map_or(REACHED, |_| "not reached");
            [
                goal.name.clone(),
                outcome.to_owned(),
                format!("{:.1}", goal.time_s),
                format!("{:.2}", goal.length_m),
                short(Some(goal.min_clearance_m).filter(|clearance| clearance.is_finite()), 3),
                short(goal.final_error_m, 3),
                short(goal.energy_per_m, 0),
            ]
        };
        let header = ["GOAL", "OUTCOME", "TIME s", "LENGTH m", "CLEARANCE m", "ERROR m", "J/m"];
        let goals = || table(&header, self.goals.iter().map(row));
        let mut lines = vec![self.walls.as_ref().map_or_else(goals, WallReport::text)];
        let reasons = self.goals.iter().filter_map(|goal| Some((&goal.name, goal.failure()?)));
        lines.extend(reasons.map(|(name, reason)| format!("{name}: {reason}")));
        let latency = &self.latency;
        lines.push(String::new());
        let map = if self.map_found { ", with a stored map" } else { "" };
        let outcome = match self.outcome {
            ScenarioOutcome::Succeeded => "succeeded",
            ScenarioOutcome::Failed => "failed",
        };
        let reason = piece(self.reason.as_ref(), |reason| format!(", {reason}"));
        lines.push(format!(
            "{} (seed {}{map}): {outcome}{reason}",
            self.scenario, self.seed
        ));
        for goal in &self.refused {
            let near = |near: GoalPoint| format!("; nearest free place {:.2}, {:.2}", near.x, near.y);
            let near = piece(goal.nearest_free, near);
            lines.push(format!("refused: goal {}: {}{near}", goal.name, goal.reason));
        }
        lines.push(format!(
            "collisions {}, {}, energy {}",
            self.collisions,
            least_clearance(self.min_clearance_m),
            energy(self.energy_j, self.energy_per_m)
        ));
        lines.push(format!(
            "simulated {:.1} s in {:.1} s at speed {}, {}, {}",
            self.sim_time_s,
            self.wall_time_s,
            self.speed,
            counted(self.plans, "plan"),
            counted(self.replans, "replan")
        ));
        lines.push(format!(
            "latency p50/p99 ms: scan to plan {}/{}, goal to motion {}/{}",
            short(latency.scan_to_plan_ms.p50, 1),
            short(latency.scan_to_plan_ms.p99, 1),
            short(latency.goal_to_motion_ms.p50, 1),
            short(latency.goal_to_motion_ms.p99, 1)
        ));
        lines.extend(self.notes.iter().map(|note| format!("note: {note}")));
        lines.extend(self.files.iter().map(|file| format!("wrote {}", file.display())));
        lines.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_hardly_driven_tells_nothing_of_the_energy_for_a_metre() {
        assert_eq!((per_metre(100.0, 1e-18), per_metre(100.0, 2.0)), (None, Some(50.0)));
        assert_eq!(energy(100.0, None), "100 J");
        assert_eq!(energy(100.0, Some(50.0)), "100 J (50 J/m)");
        assert_eq!(least_clearance(0.25), "least clearance 0.250 m");
        assert_eq!(least_clearance(f64::INFINITY), "no obstacle in reach");
    }

    #[test]
    fn percentiles_are_by_nearest_rank() {
        let samples: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(
            Percentiles::of(&samples),
            Percentiles {
                p50: Some(50.0),
                p99: Some(99.0)
            }
        );
        assert_eq!(Percentiles::of(&[]), Percentiles { p50: None, p99: None });
        assert_eq!(
            Percentiles::of(&[3.0]),
            Percentiles {
                p50: Some(3.0),
                p99: Some(3.0)
            }
        );
    }
}
