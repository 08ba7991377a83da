//! Requests. How does the robot answer requests? All of them work without a cloud.

use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    BasedOn, BehaviourAction, BehaviourReply, BehaviourReport, BehaviourRequest, BehaviourState, InfoReply,
    InfoRequest, LeaseReply, LeaseRequest, ModeReply, ModeRequest, ParamReply, ParamRequest, Refusal, ResumeRequest,
    StopReply, StopRequest,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{EdgeReply, EdgeRequest};

use crate::authority::Decision;
use crate::maneuvers::Maneuver;
use crate::maneuvers::free_place::{Pace, drives_into_unknown, free_place};
use crate::params;
use crate::passive_safety::GENTLE;
use crate::pilot::Pilot;

/// Longest id of a maneuver's execution, bytes.
const LONGEST_ID: usize = 128;

impl Pilot {
    /// Answers one request. A new kind of request is a new arm here.
    pub(crate) fn answer(&mut self, now: Stamp, request: EdgeRequest) -> Result<EdgeReply, Refusal> {
        match request {
            EdgeRequest::Lease(request) => self.lease(now, &request).map(EdgeReply::Lease),
            EdgeRequest::Stop(request) => self.stop(now, &request).map(EdgeReply::Stop),
            EdgeRequest::Resume(request) => self.resume(now, &request).map(EdgeReply::Resume),
            EdgeRequest::Mode(request) => self.set_mode(now, &request).map(EdgeReply::Mode),
            EdgeRequest::Param(request) => self.param(now, &request).map(EdgeReply::Param),
            EdgeRequest::Behaviour(request) => self.maneuver(now, &request).map(EdgeReply::Behaviour),
            EdgeRequest::Info(InfoRequest {}) => Ok(EdgeReply::Info(self.info(now))),
        }
    }

    fn lease(&mut self, now: Stamp, request: &LeaseRequest) -> Result<LeaseReply, Refusal> {
        let can_store = self.faults.storage.is_none();
        let decision = self.authority.lease(now, request, can_store, &mut self.events);
        self.carry_out(now, decision)
    }

    fn stop(&mut self, now: Stamp, request: &StopRequest) -> Result<StopReply, Refusal> {
        let decision = self.authority.stop(now, request, &mut self.events);
        self.carry_out(now, decision)
    }

    fn resume(&mut self, now: Stamp, request: &ResumeRequest) -> Result<StopReply, Refusal> {
        let decision = self.authority.resume(now, request, &mut self.events);
        self.carry_out(now, decision)
    }

    fn set_mode(&mut self, now: Stamp, request: &ModeRequest) -> Result<ModeReply, Refusal> {
        let on_lost = self.authority.set_policy(now, request)?;
        Ok(ModeReply {
            mode: self.mode(),
            on_lost,
        })
    }

    fn carry_out<R>(&mut self, now: Stamp, decision: Decision<R>) -> Result<R, Refusal> {
        if let Some(reason) = decision.discard_reason {
            self.discard(now, reason);
        }
        if decision.holder_changed {
            self.forget_discarded();
        }
        decision.answer
    }

    fn param(&mut self, now: Stamp, request: &ParamRequest) -> Result<ParamReply, Refusal> {
        if let Some(value) = request.value {
            let Some(name) = &request.name else {
                return Err(Refusal::bad_request("a value needs the `name` of its parameter"));
            };
            self.authority.admit(now, request.epoch)?;
            let reach = self.config.model.footprint.circumscribed_radius();
            params::write(&mut self.gains, &mut self.wall_following, reach, name, value)?;
            self.collision_monitor.margin = self.gains.guard_margin;
        }
        params::read(&self.gains, &self.wall_following, request.name.as_deref())
    }

    fn maneuver(&mut self, now: Stamp, request: &BehaviourRequest) -> Result<BehaviourReply, Refusal> {
        self.maneuver_report(now, request)
            .map(|report| BehaviourReply { report })
    }

    fn maneuver_report(&mut self, now: Stamp, request: &BehaviourRequest) -> Result<Option<BehaviourReport>, Refusal> {
        if request.id.is_empty() || request.id.len() > LONGEST_ID {
            return Err(Refusal::bad_request(format!("`id`: expected 1 to {LONGEST_ID} bytes")));
        }
        let known = self.maneuvers.report(&request.id).cloned();
        match request.action {
            BehaviourAction::Report => return Ok(known),
            BehaviourAction::Cancel => {
                self.authority.admit(now, request.epoch)?;
                if self.maneuvers.running() == Some(request.id.as_str()) {
                    self.maneuvers.cancel(now, "canceled", &mut self.events);
                } else if known.is_none() {
                    // Its start request may still arrive, and must then start nothing.
                    let report = BehaviourReport {
                        id: request.id.clone(),
                        state: BehaviourState::Canceled,
                        reason: Some("canceled before it began".to_owned()),
                    };
                    self.maneuvers.refuse(now, report, &mut self.events);
                }
                return Ok(self.maneuvers.report(&request.id).cloned());
            }
            _ if known.is_some() => return Ok(known),
            _ => self.authority.admit(now, request.epoch)?,
        }
        if self.authority.is_stopped() {
            return Err(Refusal::rejected("the robot is stopped"));
        }
        if let Some(running) = self.maneuvers.running() {
            return Err(Refusal::Busy {
                reason: format!("maneuver {running} is running"),
            });
        }
        self.begin_maneuver(now, request).map(Some)
    }

    /// Begins a maneuver, or reports that an obstacle is in its way.
    fn begin_maneuver(&mut self, now: Stamp, request: &BehaviourRequest) -> Result<BehaviourReport, Refusal> {
        let odom_from_base = self.estimator.odom_from_base();
        let footprint = &self.config.model.footprint;
        let unseen = self.config.settings.maneuvers.unseen_clearance;
        let (drive, settings) = (&self.config.model.drive, &self.config.settings.maneuvers);
        // An obstacle that entered the blind spot may still be there.
        let blind = self.obstacles.blind_spots().leads_into_blind_spot(-1.0)
            && self
                .obstacles
                .moving()
                .may_be_in_blind_spot(now, odom_from_base.position());
        let pace = Pace {
            speeds: [
                settings.escape_speed,
                if blind { GENTLE } else { settings.escape_speed },
            ],
            turning: settings.speed_share * drive.top_yaw_rate(),
        };
        let escape = |clearance, within| {
            let points: Vec<_> = self.obstacles.in_base(odom_from_base).collect();
            let is_free = |base_from_there: Pose2, twist, secs| {
                let there = odom_from_base * base_from_there;
                self.collision_monitor
                    .free_time(twist, secs, &self.obstacles, there)
                    .is_none()
                    && !drives_into_unknown(footprint, &self.obstacles, unseen, there, twist, secs)
            };
            free_place(footprint, &points, clearance, within, pace, is_free)
        };
        let maneuver = Maneuver::begin(
            &request.id,
            &request.action,
            now,
            odom_from_base,
            drive,
            settings,
            escape,
        )
        .map_err(Refusal::bad_request)?;
        self.discard_plan(now, "a maneuver was started");
        let blocked = maneuver.sweep().and_then(|(twist, secs)| {
            self.collision_monitor
                .free_time(twist, secs, &self.obstacles, self.estimator.odom_from_base())
        });
        Ok(match blocked {
            Some(_) => {
                let report = maneuver.report(BehaviourState::Failed, Some("obstacle in the way"));
                self.maneuvers.refuse(now, report, &mut self.events)
            }
            None => self.maneuvers.start(maneuver),
        })
    }

    fn info(&self, now: Stamp) -> InfoReply {
        InfoReply {
            component: "edge".to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            schema: SCHEMA_VERSION,
            robot: self.config.robot.to_string(),
            boot: Some(BasedOn {
                stamp: now,
                boot_id: self.events.boot_id().to_owned(),
            }),
            model: Some(self.config.model.clone()),
            pacing: Some(self.loop_timing.pacing()),
            ..InfoReply::default()
        }
    }
}
