//! Active plan. How is an accepted plan driven, renewed and ended? The plan in force, its tracker, and its expiry.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{Marker, Plan, PlanProgress};
use zenav_protocol::robot::{ControllerGains, Drive, RobotModel};
use zenav_protocol::time::Stamp;

use crate::acceptance::{Rejection, judge_course, judge_free, judge_start};
use crate::avoidance::Ahead;
use crate::local_obstacles::LocalObstacles;
use crate::settings::{EdgeSettings, PlanSettings};
use crate::trackers::{Law, Tracker, TrackerInput};

/// The plan in force.
#[derive(Clone, Debug)]
pub struct ActivePlan {
    /// As received, in its own map frame.
    plan: Plan,
    expiry: Stamp,
    tracker: Box<dyn Tracker>,
    settings: PlanSettings,
    expiry_reported: bool,
    end_reported: bool,
}

/// The robot's pose, motion and surroundings when a plan is judged.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// Footprint and limits of the robot.
    pub model: &'a RobotModel,
    /// The estimated pose.
    pub map_from_base: Pose2,
    /// The correction of odometry.
    pub map_from_odom: Pose2,
    /// Measured velocity.
    pub velocity: Twist2,
    /// Obstacles around the robot.
    pub obstacles: &'a LocalObstacles,
    /// Tunables of acceptance and following.
    pub settings: &'a EdgeSettings,
}

/// Outcome of an accepted plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// The same trajectory is valid for longer.
    Renewed,
    /// A new trajectory begins.
    Begun,
}

impl ActivePlan {
    /// Takes a plan whose header has been checked: renews the active plan, or replaces it. A rejection changes nothing.
    ///
    /// `here_from_plan` is the move of the map since the plan's frame.
    ///
    /// # Errors
    /// [`Rejection`].
    pub fn take(
        current: &mut Option<Self>,
        plan: Plan,
        here_from_plan: Pose2,
        expiry: Stamp,
        scene: &Scene<'_>,
    ) -> Result<Taken, Rejection> {
        if let Some(active) = current
            .as_mut()
            .filter(|active| active.plan.trajectory_id == plan.trajectory_id)
        {
            if active.plan.trajectory != plan.trajectory
                || active.plan.waypoints != plan.waypoints
                || active.plan.map.frame != plan.map.frame
            {
                return Err(Rejection::Changed(plan.trajectory_id));
            }
            active.plan.goal_id = plan.goal_id;
            active.plan.epoch = plan.epoch;
            active.plan.revision = plan.revision;
            active.expiry = expiry;
            active.expiry_reported = false;
            return Ok(Taken::Renewed);
        }
        judge_course(&plan, &scene.model.drive)?;
        let here = Plan {
            waypoints: plan
                .waypoints
                .iter()
                .map(|point| here_from_plan.transform_point(*point))
                .collect(),
            trajectory: plan.trajectory.moved(here_from_plan),
            ..plan.clone()
        };
        let here = if here_from_plan == Pose2::IDENTITY {
            &plan
        } else {
            &here
        };
        let tracker = if plan.trajectory.is_empty() {
            let model = scene.model;
            Law::of(&model.controller).through_waypoints(&model.drive, scene.map_from_base, here.waypoints.clone())
        } else {
            Self::begin(current.as_ref(), here, scene)?
        };
        *current = Some(Self {
            plan,
            expiry,
            tracker,
            settings: scene.settings.plan.clone(),
            expiry_reported: false,
            end_reported: false,
        });
        Ok(Taken::Begun)
    }

    /// A tracker for a trajectory that begins at a splice of the current one, or where the robot is.
    fn begin(current: Option<&Self>, plan: &Plan, scene: &Scene<'_>) -> Result<Box<dyn Tracker>, Rejection> {
        let drive = &scene.model.drive;
        let Some(first) = plan.trajectory.first() else {
            return Err(Rejection::Empty);
        };
        let old = current
            .filter(|old| !old.tracker.progress(&scene.map_from_base).finished)
            .and_then(|old| Some((old.plan.trajectory_id, old.tracker.followed()?)));
        let splice = plan.splice.and_then(|splice| {
            let (_, (old, now)) = old.filter(|(id, _)| *id == splice.trajectory_id)?;
            Some((splice.time.clamp(old.start_time(), old.end_time()), old, now))
        });
        let (trajectory, time) = match splice {
            Some((until, old, now)) => {
                let planned = old.sample(until);
                judge_start(
                    first,
                    planned.pose(),
                    planned.twist(),
                    drive,
                    &scene.settings.acceptance,
                )?;
                let late = (now - until).min(scene.settings.plan.late_splice);
                if late > 0.0 {
                    let there = plan.trajectory.sample(late);
                    judge_start(
                        &there,
                        scene.map_from_base,
                        old.sample(now).twist(),
                        drive,
                        &scene.settings.acceptance,
                    )?;
                }
                (old.spliced(now, until, &plan.trajectory), late)
            }
            None => {
                judge_start(
                    first,
                    scene.map_from_base,
                    scene.velocity,
                    drive,
                    &scene.settings.acceptance,
                )?;
                (plan.trajectory.clone(), 0.0)
            }
        };
        let obstacles: Vec<_> = scene.obstacles.standing_in(scene.map_from_odom).collect();
        judge_free(
            &trajectory,
            scene.model,
            scene.map_from_base,
            &obstacles,
            &scene.settings.acceptance,
        )?;
        let law = Law::of(&scene.model.controller);
        Ok(law.along_trajectory(drive, trajectory, time, &plan.waypoints))
    }

    /// Whether it has not expired.
    #[must_use]
    pub fn is_valid(&self, now: Stamp) -> bool {
        now < self.expiry
    }

    /// One tick: the wanted twist. With `view.speed_cap` no larger than [`Self::speed_cap`], the robot is at rest by the expiry.
    pub fn step(&mut self, view: &TrackerInput, gains: &ControllerGains) -> Twist2 {
        self.tracker.step(view, gains)
    }

    /// The rest of the plan at its own pace, sampled every `apart` s up to its end or `secs` from now; odometry frame.
    pub fn ahead(&self, odom_from_map: Pose2, secs: f64, apart: f64, out: &mut Vec<Ahead>) {
        out.clear();
        let Some((trajectory, now)) = self.tracker.followed() else {
            return;
        };
        let left = (trajectory.end_time() - now).max(0.0);
        let steps = (left.min(secs) / apart).ceil() as u32;
        out.extend((0..=steps).map(|step| {
            let secs = (apart * f64::from(step)).min(left);
            Ahead {
                secs,
                pose: odom_from_map * trajectory.sample(now + secs).pose(),
            }
        }));
    }

    /// Plan time reached, s; `None` without a trajectory.
    #[must_use]
    pub fn plan_time(&self) -> Option<f64> {
        self.tracker.followed().map(|(_, now)| now)
    }

    /// Position on the plan `secs` from now at the plan's own pace, map frame; its end after that. `None` without a trajectory.
    #[must_use]
    pub fn place_in(&self, secs: f64) -> Option<Point2<f64>> {
        let (trajectory, now) = self.tracker.followed()?;
        Some(trajectory.sample(now + secs).pose().position())
    }

    /// Another source drives the robot: the tracker continues from the nearest place on the plan.
    pub fn rejoin(&mut self, map_from_base: &Pose2) {
        self.tracker.rejoin(map_from_base);
    }

    /// Why the plan can no longer be followed, if so; `off_track` replaces the usual distance at which the plan is lost, m.
    #[must_use]
    pub fn lost(&self, off_track: Option<f64>) -> Option<&'static str> {
        let limit = off_track.unwrap_or(self.settings.off_track);
        (self.tracker.off_track() > limit).then_some("too far off the trajectory")
    }

    /// True once, when the end has been reached.
    pub fn ends(&mut self, map_from_base: &Pose2) -> bool {
        let ends = self.tracker.progress(map_from_base).finished && !self.end_reported;
        self.end_reported |= ends;
        ends
    }

    /// True once for each validity, when the plan expires before its end was reached.
    pub fn expires(&mut self, now: Stamp) -> bool {
        let expires = !self.is_valid(now) && !self.expiry_reported && !self.end_reported;
        self.expiry_reported |= expires;
        expires
    }

    /// Whether the robot is at rest at the end.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        self.end_reported
    }

    /// Carries the tracked path over to another map frame.
    pub fn moved(&mut self, new_from_old: Pose2) {
        self.tracker.moved(new_from_old);
    }

    /// The plan as received.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Progress along the plan.
    #[must_use]
    pub fn progress(&self, now: Stamp, map_from_base: &Pose2) -> PlanProgress {
        let progress = self.tracker.progress(map_from_base);
        PlanProgress {
            goal_id: self.plan.goal_id.clone(),
            epoch: self.plan.epoch,
            revision: self.plan.revision,
            trajectory_id: self.plan.trajectory_id,
            // Negative while the rest of the trajectory before a splice is driven.
            time: progress.time,
            waypoint: progress.waypoint,
            distance_left: progress.distance_left,
            time_left: progress.time_left,
            valid_for: self.expiry.secs_since(now).max(0.0),
            finished: self.end_reported,
        }
    }

    /// Time left by the plan, s.
    pub(crate) fn time_left(&self, map_from_base: &Pose2) -> f64 {
        self.tracker.progress(map_from_base).time_left
    }

    /// Marker of the waypoint or reference that the robot drives to.
    #[must_use]
    pub fn marker(&self, now: Stamp) -> Option<Marker> {
        let (name, point) = self.tracker.target()?;
        Some(Marker {
            stamp: now,
            name: name.to_owned(),
            points: vec![point],
        })
    }

    /// Largest wheel surface speed from which the robot comes to rest by the expiry, the motors' lag included, m/s; `tick` is the control
    /// period, s.
    #[must_use]
    pub fn speed_cap(&self, now: Stamp, tick: f64, drive: &Drive) -> f64 {
        let usable = self.expiry.secs_since(now) - 4.0 * drive.motor_lag - 2.0 * tick;
        (self.settings.braking_share * drive.acceleration() * usable).max(0.0)
    }

    /// Largest wheel surface speed from which the robot comes to rest within `way` m, the motors' lag at this speed included, m/s.
    #[must_use]
    pub fn speed_cap_within(&self, way: f64, tick: f64, drive: &Drive) -> f64 {
        let braking = self.settings.braking_share * drive.acceleration();
        let lag = braking * (4.0 * drive.motor_lag + 2.0 * tick);
        (lag * lag + 2.0 * braking * way.max(0.0)).sqrt() - lag
    }
}
