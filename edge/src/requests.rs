//! How are asks to the robot answered? Every one of them works with no cloud.

use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::*;
use zenav_protocol::time::Stamp;

use crate::authority::Decision;
use crate::control_io::{Answer, Question};
use crate::maneuvers::Maneuver;
use crate::nearest_free::{backs_into_the_unknown, nearest_free};
use crate::params;
use crate::pilot::Pilot;

/// Longest id of a behaviour's execution.
const LONGEST_ID: usize = 128;

impl Pilot {
    /// Answers one ask.
    pub(crate) fn answer(&mut self, now: Stamp, question: Question) -> Result<Answer, Refusal> {
        match question {
            Question::Lease(request) => {
                let ruling = self.authority.lease(now, &request, &mut self.journal);
                self.carry_out(now, ruling).map(Answer::Lease)
            }
            Question::Stop(request) => {
                let ruling = self.authority.stop(now, &request, &mut self.journal);
                self.carry_out(now, ruling).map(Answer::Stop)
            }
            Question::Resume(request) => {
                let ruling = self.authority.resume(now, &request, &mut self.journal);
                self.carry_out(now, ruling).map(Answer::Stop)
            }
            Question::Mode(request) => {
                let on_lost = self.authority.set_policy(now, &request)?;
                Ok(Answer::Mode(ModeReply {
                    mode: self.mode(),
                    on_lost,
                }))
            }
            Question::Param(request) => self.param(now, &request).map(Answer::Param),
            Question::Maneuver(request) => self
                .behaviour(now, &request)
                .map(|report| Answer::Maneuver(BehaviourReply { report })),
            Question::Info(InfoRequest {}) => Ok(Answer::Info(Box::new(self.info(now)))),
        }
    }

    fn carry_out<R>(&mut self, now: Stamp, ruling: Decision<R>) -> Result<R, Refusal> {
        if let Some(reason) = ruling.void {
            self.discard(now, reason);
        }
        if ruling.holder_changed {
            self.forget_discarded();
        }
        ruling.answer
    }

    fn param(&mut self, now: Stamp, request: &ParamRequest) -> Result<ParamReply, Refusal> {
        if let Some(value) = request.value {
            let Some(name) = &request.name else {
                return Err(Refusal::bad_request("a value needs the `name` of its parameter"));
            };
            self.authority.admit(now, request.epoch)?;
            let reach = self.config.model.footprint.circumscribed_radius();
            params::write(&mut self.gains, &mut self.wall_following, reach, name, value)?;
            self.guard.margin = self.gains.guard_margin;
        }
        params::read(&self.gains, &self.wall_following, request.name.as_deref())
    }

    fn behaviour(&mut self, now: Stamp, request: &BehaviourRequest) -> Result<Option<BehaviourReport>, Refusal> {
        if request.id.is_empty() || request.id.len() > LONGEST_ID {
            return Err(Refusal::bad_request(format!("`id`: expected 1 to {LONGEST_ID} bytes")));
        }
        let known = self.behaviours.report(&request.id).cloned();
        match request.action {
            BehaviourAction::Report => return Ok(known),
            BehaviourAction::Cancel => {
                self.authority.admit(now, request.epoch)?;
                if self.behaviours.running() == Some(request.id.as_str()) {
                    self.behaviours.cancel(now, "canceled", &mut self.journal);
                }
                return Ok(self.behaviours.report(&request.id).cloned());
            }
            _ if known.is_some() => return Ok(known),
            _ => self.authority.admit(now, request.epoch)?,
        }
        if self.authority.is_stopped() {
            return Err(Refusal::rejected("the robot is stopped"));
        }
        if let Some(running) = self.behaviours.running() {
            return Err(Refusal::Busy {
                reason: format!("the behaviour {running} runs"),
            });
        }
        let odom_from_base = self.estimator.odom_from_base();
        let way_to_free = |clearance, within| {
            let points: Vec<_> = self.around.in_base(odom_from_base).collect();
            let is_free = |base_from_there: Pose2, twist, secs| {
                let there = odom_from_base * base_from_there;
                self.guard.free_time(twist, secs, &self.around, there).is_none()
                    && !backs_into_the_unknown(&self.config.model.footprint, &self.around, there, twist, secs)
            };
            nearest_free(&self.config.model.footprint, &points, clearance, within, is_free)
        };
        let behaviour = Maneuver::begin(
            &request.id,
            &request.action,
            now,
            odom_from_base,
            &self.config.model.drive,
            way_to_free,
        )
        .map_err(Refusal::bad_request)?;
        self.discard_plan(now, "a behaviour was started");
        let blocked = behaviour.sweep().and_then(|(twist, secs)| {
            self.guard
                .free_time(twist, secs, &self.around, self.estimator.odom_from_base())
        });
        Ok(Some(match blocked {
            Some(_) => {
                let report = behaviour.report(BehaviourState::Failed, Some("something is in the way"));
                self.behaviours.refuse(now, report, &mut self.journal)
            }
            None => self.behaviours.start(behaviour),
        }))
    }

    fn info(&self, now: Stamp) -> InfoReply {
        InfoReply {
            component: "edge".to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            schema: SCHEMA_VERSION,
            robot: self.config.robot.to_string(),
            boot: Some(BasedOn {
                stamp: now,
                boot_id: self.journal.boot_id().to_owned(),
            }),
            model: Some(self.config.model.clone()),
            pacing: Some(self.punctuality.pacing()),
            ..InfoReply::default()
        }
    }
}
