//! Nav2's decorators that follow a robot or its goals. When is the child ticked? When the robot has driven far enough, at a rate that
//! depends on its speed, when its goal has changed, or when its path has become much longer (nav2_behavior_tree 1.5).
//!
//! They access the context through [`Travel`]; a simulation has a stationary robot.

use super::conditions::goals;
use crate::leaf::{Decorator, Enter, LeafIo};
use crate::node::nanos;
use crate::ports::PortError;
use crate::status::Status;
use crate::value::Value;

/// What is known about the robot driven by a tree. Map frame.
pub trait Travel {
    /// Its position, m; `None` if unknown.
    fn position(&self) -> Option<[f64; 2]>;
    /// Its speed regardless of direction, m/s.
    fn speed(&self) -> f64;
    /// Measures a path from the blackboard; `None` for an invalid or empty path.
    fn measure(&self, path: &Value) -> Option<Measure>;
}

/// Measures of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measure {
    /// Its end point, m.
    pub end: [f64; 2],
    /// Its length, m.
    pub length: f64,
    /// Its length from the robot's position, m.
    pub left: f64,
}

/// Constructor of a decorator.
pub type MakeDecorator<C> = fn() -> Box<dyn Decorator<C>>;

/// Constructor of the decorator with this id, if it is one of these.
pub fn decorator<C: Travel>(id: &str) -> Option<MakeDecorator<C>> {
    Some(match id {
        "DistanceController" => || Box::new(DistanceController),
        "SpeedController" => || Box::new(SpeedController::default()),
        "GoalUpdatedController" => || Box::new(GoalUpdatedController),
        "GoalUpdater" => || Box::new(GoalUpdater),
        "PathLongerOnApproach" => || Box::new(PathLongerOnApproach::default()),
        _ => return None,
    })
}

/// Ticks the child on activation, while it runs, and when the robot is `distance` (m, straight) from where the child last succeeded;
/// otherwise `Running`. Without a position: `Failure`.
struct DistanceController;

impl<C: Travel> Decorator<C> for DistanceController {
    fn enter(&mut self, io: &mut LeafIo<'_>, ctx: &mut C, child: Status) -> Enter {
        let Some(here) = ctx.position() else {
            return Enter::Answer(io.fail("nobody knows where the robot is"));
        };
        let distance = match io.number_or("distance", 1.0) {
            Ok(distance) => distance,
            Err(wrong) => return Enter::Answer(io.fail(wrong)),
        };
        let from: Option<[f64; 2]> = io.recall();
        let first = !io.previous().is_active();
        if first {
            // A pair of numbers is always serialisable.
            let _ = io.remember(&here);
        }
        let come = from.is_some_and(|from| (here[0] - from[0]).hypot(here[1] - from[1]) >= distance);
        Enter::child_if(first || child == Status::Running || come)
    }

    fn leave(&mut self, io: &mut LeafIo<'_>, ctx: &mut C, child: Status) -> Status {
        if let (Status::Success, Some(here)) = (child, ctx.position()) {
            let _ = io.remember(&here);
        }
        child
    }
}

/// Ticks the child on activation, while it runs, and once per period: `max_rate` at first and after a new goal, then the rate for the speed
/// at the end of each period.
#[derive(Default)]
struct SpeedController {
    goals: [Option<Value>; 2],
    rhythm: Option<Rhythm>,
}

struct Rhythm {
    since: u64,
    period: f64,
}

impl<C: Travel> Decorator<C> for SpeedController {
    fn enter(&mut self, io: &mut LeafIo<'_>, ctx: &mut C, child: Status) -> Enter {
        let ports = [
            ("min_rate", 0.1),
            ("max_rate", 1.0),
            ("min_speed", 0.0),
            ("max_speed", 0.5),
        ];
        let mut numbers = [0.0; 4];
        for (slot, (port, otherwise)) in numbers.iter_mut().zip(ports) {
            match io.number_or(port, otherwise) {
                Ok(value) => *slot = value,
                Err(wrong) => return Enter::Answer(io.fail(wrong)),
            }
        }
        let [min_rate, max_rate, min_speed, max_speed] = numbers;
        if !(min_rate > 0.0 && max_rate >= min_rate && min_speed >= 0.0 && max_speed > min_speed) {
            return Enter::Answer(io.abort("expected 0 < min_rate <= max_rate and 0 <= min_speed < max_speed"));
        }
        let now = nanos(io.now());
        let goals = goals(io);
        if !io.previous().is_active() || goals != self.goals {
            (self.goals, self.rhythm) = (goals, None);
        }
        let first = self.rhythm.is_none();
        let rhythm = self.rhythm.get_or_insert(Rhythm {
            since: now,
            period: 1.0 / max_rate,
        });
        let over = now.saturating_sub(rhythm.since) as f64 * 1e-9 >= rhythm.period;
        if over {
            let share = (ctx.speed() - min_speed) / (max_speed - min_speed);
            let rate = (min_rate + share * (max_rate - min_rate)).clamp(min_rate, max_rate);
            *rhythm = Rhythm {
                since: now,
                period: 1.0 / rate,
            };
        }
        Enter::child_if(first || over || child == Status::Running)
    }
}

/// Ticks the child on activation, when a goal has changed, and while it runs; otherwise `Running`.
struct GoalUpdatedController;

impl<C> Decorator<C> for GoalUpdatedController {
    fn enter(&mut self, io: &mut LeafIo<'_>, _: &mut C, child: Status) -> Enter {
        let goals = goals(io);
        let seen: Option<[Option<Value>; 2]> = io.recall();
        let changed = !io.previous().is_active() || seen.as_ref() != Some(&goals);
        if changed && io.remember(&goals).is_err() {
            return Enter::Answer(io.fail("goal cannot be kept"));
        }
        Enter::child_if(changed || child == Status::Running)
    }
}

/// Writes the newer of a goal and its update to the output and ticks the child. Nav2 receives updates on the topics `goal_update` and
/// `goals_update`; here they are entries with these names on the root blackboard, JSON with a `stamp`. An update that is older than its
/// input, or has no stamp, is ignored.
struct GoalUpdater;

/// Time at which a goal was given, if stated.
fn stamp(goal: &Value) -> Option<f64> {
    match goal {
        Value::Data(data) => data.get("stamp")?.as_f64(),
        Value::Text(text) => {
            let text = text.trim_start();
            let json = text.strip_prefix("json:").unwrap_or(text);
            serde_json::from_str::<serde_json::Value>(json)
                .ok()?
                .get("stamp")?
                .as_f64()
        }
        _ => None,
    }
}

impl<C> Decorator<C> for GoalUpdater {
    fn enter(&mut self, io: &mut LeafIo<'_>, _: &mut C, _: Status) -> Enter {
        for (input, output, update) in [
            ("input_goal", "output_goal", "@goal_update"),
            ("input_goals", "output_goals", "@goals_update"),
        ] {
            let given = io.value(input).ok().cloned();
            let newer = io.entry(update).cloned().filter(|update| {
                let before = given.as_ref().and_then(stamp).unwrap_or(0.0);
                stamp(update).is_some_and(|stamp| stamp >= before)
            });
            // Equal goals can have different forms, and writing an equal value is not an update.
            let chosen = newer.or(given);
            if let Some(chosen) = chosen
                && let Err(wrong) = io.set(output, chosen)
            {
                return Enter::Answer(io.fail(wrong.to_string()));
            }
        }
        Enter::TickChild
    }
}

/// Ticks the child while the path to the same goal has just become more than `length_factor` times as long, and the robot was within
/// `prox_len` (m of path) of the goal; otherwise `Success`.
#[derive(Default)]
struct PathLongerOnApproach {
    old: Option<Value>,
}

impl PathLongerOnApproach {
    fn is_longer<C: Travel>(&self, io: &LeafIo<'_>, ctx: &C, new: &Value) -> Result<bool, PortError> {
        let Some(old) = self.old.as_ref().filter(|old| *old != new) else {
            return Ok(false);
        };
        let (Some(was), Some(is)) = (ctx.measure(old), ctx.measure(new)) else {
            return Ok(false);
        };
        let near = was.left < io.number_or("prox_len", 3.0)?;
        let longer = is.length > io.number_or("length_factor", 2.0)? * was.length;
        Ok(was.end == is.end && near && longer)
    }
}

impl<C: Travel> Decorator<C> for PathLongerOnApproach {
    fn enter(&mut self, io: &mut LeafIo<'_>, ctx: &mut C, _: Status) -> Enter {
        let new = io.value("path").ok().cloned();
        let longer = match &new {
            Some(new) => self.is_longer(io, ctx, new),
            None => Ok(false),
        };
        match longer {
            Ok(true) => Enter::TickChild,
            Ok(false) => {
                self.old = new;
                Enter::Answer(Status::Success)
            }
            Err(wrong) => Enter::Answer(io.fail(wrong)),
        }
    }

    fn leave(&mut self, io: &mut LeafIo<'_>, _: &mut C, child: Status) -> Status {
        if child.is_completed() {
            self.old = io.value("path").ok().cloned();
        }
        child
    }
}
