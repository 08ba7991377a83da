//! Watching a goal. Follows the state that the mission publishes and also polls the mission: a restarted mission or a cut link must not
//! leave a watcher waiting for ever.

use std::time::Duration;

use indicatif::ProgressBar;
use zenav_protocol::bus::{Bus, Latest};
use zenav_protocol::messages::{GoalState, GoalsRequest};
use zenav_protocol::topics;

use super::{Report, no_goal, phase_code};
use crate::connect::{self, RobotArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::leadership;
use crate::live_map::{Drawing, LiveMap};
use crate::output::{self, Format};

/// Period of polling the mission.
const ASK_EVERY: Duration = Duration::from_secs(2);
/// Longest wait for its answer.
const ANSWER_WITHIN: Duration = Duration::from_millis(1500);
/// After so many answers in a row without the goal, the mission is taken to have another store: it will never know the goal.
const MOST_UNKNOWN: u32 = 5;

/// Watches one goal.
pub(super) struct Watch {
    bus: Bus,
    robot: String,
    id: String,
    states: Latest<GoalState>,
}

impl Watch {
    pub(super) fn new(bus: &Bus, robot: &str, id: &str) -> Result<Self, Failure> {
        Ok(Self {
            bus: bus.clone(),
            robot: robot.to_owned(),
            id: id.to_owned(),
            states: bus.latest(&topics::GOAL_STATE, &[robot, id])?,
        })
    }

    /// Calls `changed` with every new state until the goal ends, then prints it; the exit code is the goal's end. Ctrl-C detaches.
    pub(super) async fn until_end(mut self, format: Format, mut changed: impl FnMut(&GoalState)) -> Outcome {
        let mut ask = tokio::time::interval(ASK_EVERY);
        ask.reset();
        let interrupted = tokio::signal::ctrl_c();
        tokio::pin!(interrupted);
        let (mut silent, mut unknown) = (false, 0);
        loop {
            let state = tokio::select! {
                _ = &mut interrupted => {
                    let (id, robot) = (&self.id, &self.robot);
                    crate::output::note(format_args!("zenav: detached; goal {id} continues (`zenav goal watch {id} --robot {robot}`, `zenav goal cancel {id} --robot {robot}`)"));
                    return Ok(exit_code::INTERRUPTED);
                }
                received = self.states.next() => received.ok_or_else(Failure::closed)?.message,
                _ = ask.tick() => match query(&self.bus, &self.robot, &self.id, ANSWER_WITHIN).await {
                    Ok(Some(state)) => {
                        (silent, unknown) = (false, 0);
                        state
                    }
                    Ok(None) if unknown >= MOST_UNKNOWN => return Err(no_goal(&self.robot, &self.id)),
                    // Not an end: the mission may be away, or its store may still be loading.
                    answer => {
                        unknown = if answer.is_ok() { unknown + 1 } else { 0 };
                        if !silent {
                            tracing::warn!(goal = self.id, "the mission does not answer; waiting for it");
                            silent = true;
                        }
                        continue;
                    }
                },
            };
            changed(&state);
            if state.state.is_end() {
                output::value(format, &Report::of(&state), Report::line)?;
                return Ok(phase_code(state.state));
            }
        }
    }
}

/// The goal as the mission knows it; `None` if the mission does not know it.
async fn query(bus: &Bus, robot: &str, id: &str, within: Duration) -> Result<Option<GoalState>, Failure> {
    let request = GoalsRequest {
        id: Some(id.to_owned()),
        ..GoalsRequest::default()
    };
    let reply = leadership::ask(bus, &topics::GOALS, robot, &request, within).await?;
    Ok(reply.goals.into_iter().find(|goal| goal.id == id))
}

/// `zenav goal watch ID`.
pub(super) fn watch(robot: &RobotArgs, format: Format, id: &str) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        if zenav_protocol::id::Id::new(id).is_err() {
            return Err(no_goal(&robot, id));
        }
        let watch = Watch::new(&bus, &robot, id)?;
        let Some(state) = query(&bus, &robot, id, patience).await? else {
            return Err(no_goal(&robot, id));
        };
        if state.state.is_end() {
            output::value(format, &Report::of(&state), Report::line)?;
            return Ok(phase_code(state.state));
        }
        let mut progress = Progress::new();
        progress.show(&state);
        watch
            .until_end(format, |state| match format {
                Format::Ndjson if !state.state.is_end() => {
                    // Here every change is data, not only the end.
                    let _ = output::value(format, state, |_| String::new());
                }
                _ => progress.show(state),
            })
            .await
    })
}

/// A goal's progress on stderr: one updated line on a terminal, otherwise a line per step.
pub(super) struct Progress {
    bar: Option<ProgressBar>,
    drawing: Option<Drawing>,
    last: String,
}

impl Progress {
    pub(super) fn new() -> Self {
        Self {
            bar: output::spinner(),
            drawing: None,
            last: String::new(),
        }
    }

    /// Draws the robot's map above the line, on a terminal.
    pub(super) fn draw(&mut self, map: LiveMap) {
        self.drawing = self.bar.as_ref().map(|bar| map.above(bar));
    }

    pub(super) fn say(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(text.to_owned()),
            None => crate::output::note(text),
        }
    }

    pub(super) fn show(&mut self, state: &GoalState) {
        if state.state.is_end() {
            self.drawing = None;
            if let Some(bar) = self.bar.take() {
                bar.finish_and_clear();
            }
            return;
        }
        let step = format!("{:?} {}", state.state, state.feedback.step);
        let step = step.trim_end();
        let left = output::piece(state.feedback.distance_left, |m| format!(", {m:.2} m left"));
        match &self.bar {
            Some(_) => self.say(&format!("{step}{left}")),
            None if step != self.last => self.say(&format!("{} {step}{left}", state.id)),
            None => {}
        }
        step.clone_into(&mut self.last);
    }
}
