//! Edge settings. What can be tuned on the robot's side, in which unit, within which bounds, and why is the default what it is?
//!
//! One section per subsystem; a deployment file holds them as `[robots.NAME.edge.collision_monitor]` and so on. Values that belong to one
//! robot model (gains, distances of the wall follower) are in the robot file instead. Numerical epsilons and memory bounds stay private
//! constants of their subsystem.

use std::ops::RangeInclusive;

use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::sensors::LidarModel;
use zenav_protocol::settings::check;

use crate::blind_spot_grid::SIDE;

/// A person walks at up to this speed, m/s.
const WALKING: f64 = 1.4;
/// People turn a corner that they cannot see round at up to this speed, unless set, m/s.
const ROUND_CORNERS: f64 = 0.7;
/// Age of a lidar scan at which a robot stops, and time from the last scan until it is at rest, unless it needs longer or they are set, s.
const STOPPED_AFTER: (f64, f64) = (1.0, 0.7);
/// Share of the top speed at which a robot may still drive when the next scan is due: without `rest_after_silence`, and at the least value
/// of it that is accepted.
const SPEED_KEPT: (f64, f64) = (0.9, 0.25);

zenav_protocol::settings! {
    /// All tunables of an edge.
    ///
    /// ```
    /// use zenav_edge::EdgeSettings;
    /// use zenav_protocol::settings::Settings;
    ///
    /// let settings: EdgeSettings = serde_json::from_str(r#"{"lease": {"lost_after": 5.0}}"#)?;
    /// assert_eq!((settings.lease.lost_after, settings.lease.ttl), (5.0, 1.0));
    /// let hasty: EdgeSettings = serde_json::from_str(r#"{"lease": {"lost_after": 0.2}}"#)?;
    /// assert_eq!(hasty.check().unwrap_err().to_string(), "`lease.lost_after` is 0.2: expected at least `stale_after`, 0.5");
    /// # Ok::<(), serde_json::Error>(())
    /// ```
    pub struct EdgeSettings {
        /// The body's readings.
        pub body: BodySettings;
        /// Lease and link.
        pub lease: LeaseSettings;
        /// Plan acceptance.
        pub acceptance: AcceptanceSettings;
        /// Following an accepted plan to its end or expiry.
        pub plan: PlanSettings;
        /// Teleop.
        pub teleop: TeleopSettings;
        /// Maneuvers: spin, back up, wait, drive to free space.
        pub maneuvers: ManeuverSettings;
        /// Wall follower, beyond what the robot file sets.
        pub wall_follower: WallFollowerSettings;
        /// Return to home.
        pub return_home: ReturnHomeSettings;
        /// Collision monitor.
        pub collision_monitor: CollisionMonitorSettings;
        /// Passive safety: the limits that the collision monitor applies.
        pub passive_safety: PassiveSafetySettings;
        /// Local obstacle memory.
        pub local_obstacles: LocalObstacleSettings;
        /// Contact memory: what the robot touched and no beam shows.
        pub contact_memory: ContactMemorySettings;
        /// Blind-spot grid: floor known to be free where no lidar sees.
        pub blind_spot_grid: BlindSpotGridSettings;
        /// Scan reprojection: which returns of one scan do the beams of another pass through?
        pub scan_reprojection: ScanReprojectionSettings;
        /// Detection of moving obstacles.
        pub moving_obstacles: MovingObstacleSettings;
        /// Tracks of moving obstacles.
        pub tracking: TrackingSettings;
        /// Predictive control among moving obstacles.
        pub avoidance: AvoidanceSettings;
        /// Right of way: where the robot waits for other robots.
        pub right_of_way: RightOfWaySettings;
        /// Pose estimator.
        pub estimator: EstimatorSettings;
        /// Standing still to learn the gyro's bias.
        pub settling: SettlingSettings;
        /// Telemetry.
        pub telemetry: TelemetrySettings;
        /// Narrow links.
        pub uplink: UplinkSettings;
    }
    check = |edge: &EdgeSettings| {
        let (range, most) = (edge.local_obstacles.range, edge.blind_spot_grid.range());
        match range <= most {
            true => Ok(()),
            false => Err(OutOfBounds::unlike("local_obstacles.range", range, format!("at most {most:.2}, what `blind_spot_grid.cell` covers"))),
        }
    };
}

zenav_protocol::settings! {
    /// The body's readings.
    pub struct BodySettings {
        /// Longest step between the stamps of a body that is accepted at once; a longer one must be confirmed by several readings in a
        /// row.
        pub longest_step: f64 = 1.0, "s", 0.05..=60.0;
    }
}

zenav_protocol::settings! {
    /// Lease and link.
    pub struct LeaseSettings {
        /// Time to live of a lease without a heartbeat (contract: 1 s, ten heartbeats).
        pub ttl: f64 = 1.0, "s", 0.1..=60.0;
        /// Age of the last renewal at which the link is `Stale` (contract).
        pub stale_after: f64 = 0.5, "s", 0.05..=60.0;
        /// Age of the last renewal at which the link is `Lost` (contract).
        pub lost_after: f64 = 3.0, "s", 0.1..=3600.0;
    }
    check = |lease: &LeaseSettings| match lease.stale_after <= lease.lost_after {
        true => Ok(()),
        false => Err(OutOfBounds::unlike("lost_after", lease.lost_after, format!("at least `stale_after`, {}", lease.stale_after))),
    };
}

zenav_protocol::settings! {
    /// Plan acceptance.
    pub struct AcceptanceSettings {
        /// Longest validity that a plan may claim; a longer one is cut.
        pub max_validity: f64 = 60.0, "s", 0.5..=3600.0;
        /// Longest step of a writer's counter, and of its incarnation, between two accepted plans of a lease (one plan a second for 11
        /// days).
        pub longest_step: u64 = 1_000_000, "", 1..=1_000_000_000;
        /// Largest distance between the start of a trajectory and the predicted position of the robot.
        pub start_distance: f64 = 0.25, "m", 0.01..=2.0;
        /// Largest heading difference at the start.
        pub start_yaw: f64 = 0.6, "rad", 0.01..=3.2;
        /// Largest difference in wheel surface speed at the start.
        pub start_speed: f64 = 0.35, "m/s", 0.01..=5.0;
        /// The footprint checked against the scan is smaller than the true one by this, to allow for range noise.
        pub scan_tolerance: f64 = 0.02, "m", 0.0..=0.2;
        /// It is smaller by this much more for each metre from the robot, to allow for heading error.
        pub scan_tolerance_per_metre: f64 = 0.01, "m/m", 0.0..=0.2;
        /// The scan is not used beyond this distance from the robot.
        pub scan_horizon: f64 = 4.0, "m", 0.5..=50.0;
    }
}

zenav_protocol::settings! {
    /// Following an accepted plan to its end or expiry.
    pub struct PlanSettings {
        /// Share of the normal deceleration used to brake for the plan's expiry; the rest is left for control.
        pub braking_share: f64 = 0.9, "", 0.1..=1.0;
        /// How far in the past the splice of an arriving replan may lie.
        pub late_splice: f64 = 1.5, "s", 0.0..=10.0;
        /// Distance from the plan's reference at which the plan is discarded.
        pub off_track: f64 = 0.6, "m", 0.05..=10.0;
    }
}

zenav_protocol::settings! {
    /// Teleop.
    pub struct TeleopSettings {
        /// Dead-man timeout: a twist acts until the edge stamp that it echoes is this old (contract: 0.3 s).
        pub dead_man: f64 = 0.3, "s", 0.05..=2.0;
    }
}

zenav_protocol::settings! {
    /// Maneuvers: spin, back up, wait, drive to free space.
    pub struct ManeuverSettings {
        /// Share of the robot's top speeds that maneuvers use.
        pub speed_share: f64 = 0.8, "", 0.05..=1.0;
        /// Speed of the drive to a free place.
        pub escape_speed: f64 = 0.1, "m/s", 0.01..=1.0;
        /// Largest speed of a maneuver or an evasion into the lidar's blind spot, over floor seen before: the path was checked when it
        /// began.
        pub blind_speed: f64 = 0.15, "m/s", 0.0..=1.0;
        /// A maneuver fails after the collision monitor has stopped it for this long.
        pub blocked_timeout: f64 = 1.0, "s", 0.1..=60.0;
        /// Heading feedback gain of a straight drive.
        pub straight_gain: f64 = 2.0, "1/s", 0.0..=20.0;
        /// Remaining turn at which a spin is done.
        pub turn_tolerance: f64 = 0.02, "rad", 0.001..=0.5;
        /// Remaining distance at which a drive is done.
        pub distance_tolerance: f64 = 0.005, "m", 0.001..=0.5;
        /// Clearance that a drive to a free place into the blind spot keeps from floor not known to be free: more than the collision
        /// monitor requires.
        pub unseen_clearance: f64 = 0.1, "m", 0.0..=1.0;
    }
}

zenav_protocol::settings! {
    /// Wall follower, beyond what the robot file sets.
    pub struct WallFollowerSettings {
        /// Clearance on both sides of the body where the robot goes straight.
        pub side_clearance: f64 = 0.05, "m", 0.0..=1.0;
        /// The robot turns elsewhere after the collision monitor has stopped it for this long.
        pub blocked_timeout: f64 = 1.0, "s", 0.1..=60.0;
        /// A wall shorter than this is approached only if there is no longer one: a pillar is not a wall.
        pub short_wall: f64 = 0.5, "m", 0.0..=10.0;
        /// A wall is split where a return is farther from its chord than this …
        pub bend: f64 = 0.02, "m", 0.001..=0.5;
        /// … and than this many standard deviations of the lidar's range noise.
        pub bend_sigmas: f64 = 4.0, "", 0.0..=20.0;
        /// The approach switches to another wall only if that wall is nearer by this.
        pub nearer_wall: f64 = 0.1, "m", 0.0..=5.0;
        /// A wall this near to the point approached so far counts as the same wall.
        pub same_wall: f64 = 0.3, "m", 0.01..=5.0;
        /// Heading error that ends an approach.
        pub astray: f64 = 0.6, "rad", 0.05..=3.2;
        /// The path ahead is clear when it is free for this many target distances.
        pub clear_ahead: f64 = 2.0, "", 0.5..=20.0;
        /// Rate limit of the wall distance to keep, as a share of the robot's speed.
        pub widening: f64 = 0.6, "", 0.01..=5.0;
        /// A wall is lost beyond this many times the largest distance to keep.
        pub lost_factor: f64 = 1.4, "", 1.0..=10.0;
        /// The bump state ends once an operator has driven the robot this far from the contact.
        pub bump_clearance: f64 = 0.05, "m", 0.0..=1.0;
    }
}

zenav_protocol::settings! {
    /// Return to home.
    pub struct ReturnHomeSettings {
        /// Spacing of the recorded trail; a loop that comes back this near to the trail is cut off.
        pub spacing: f64 = 0.2, "m", 0.05..=5.0;
    }
}

zenav_protocol::settings! {
    /// Collision monitor.
    pub struct CollisionMonitorSettings {
        /// A lidar scan older than this stops the robot; if unset, 1 s, or the latency and two periods of its slowest lidar if that is
        /// longer.
        pub scan_timeout: Option<f64> = None, "s";
        /// Once scans stop arriving, the robot is at rest this long after the last one; if unset, 0.7 s, or what it needs to drive at nine
        /// tenths of its top speed until the next scan is due, if that is longer: the period of its slowest lidar, a control period,
        /// `passive_safety.lags_to_rest` motor time constants, and the time to brake. A value that leaves less than a quarter of the top
        /// speed is refused.
        pub rest_after_silence: Option<f64> = None, "s";
        /// Share of the top speed allowed while the wheel encoders are silent.
        pub without_encoders: f64 = 0.5, "", 0.0..=1.0;
        /// Share of the top speed allowed while a lidar looks elsewhere than its file says: obstacles are not where they seem to be.
        pub with_crooked_lidar: f64 = 0.5, "", 0.0..=1.0;
        /// A zone is left for a milder one once it has not been needed for this long.
        pub hysteresis: f64 = 0.3, "s", 0.0..=5.0;
        /// In contact, a motion counts as leading away if it moves away from the contact at this share of its speed at least.
        pub departure_share: f64 = 0.2, "", 0.0..=1.0;
        /// Largest speed of a plan or a maneuver into the lidar's blind spot, including floor that was never seen, while nothing has been
        /// seen to move since the start or for `moving_obstacles.memory_backing`: the robot feels its way until its bumper stops it. Set it
        /// to 0 on a robot without a bumper: nothing else would detect an obstacle there.
        pub feeling_speed: f64 = 0.05, "m/s", 0.0..=0.3;
        /// Largest speed along a contact.
        pub sliding_speed: f64 = 0.1, "m/s", 0.0..=1.0;
        /// A motion scaled to less than this share of the wanted twist counts as stopped.
        pub stop_share: f64 = 0.02, "", 0.0..=0.5;
        /// A motion scaled to more than this share of it counts as clear.
        pub clear_share: f64 = 0.95, "", 0.5..=1.0;
    }
    check = |monitor: &CollisionMonitorSettings| {
        let set = |key: &str, value: Option<f64>, bounds: RangeInclusive<f64>| {
            value.map_or(Ok(()), |value| check(key, value, "s", &bounds))
        };
        set("scan_timeout", monitor.scan_timeout, 0.05..=30.0)?;
        set("rest_after_silence", monitor.rest_after_silence, 0.1..=60.0)
    };
}

zenav_protocol::settings! {
    /// Passive safety: the limits that the collision monitor applies.
    pub struct PassiveSafetySettings {
        /// Assumed speed of moving obstacles in view that have no track yet; if unset, the robot's own top speed.
        pub speed_in_view: Option<f64> = None, "m/s";
        /// Assumed speed of moving obstacles that have left the field of view, and of people behind corners; if unset, that of a walking
        /// person, 1.4 m/s, or the robot's own top speed if that is greater, and behind corners its own, at most 0.7 m/s (at 1.4 m/s it
        /// creeps at narrow corners).
        pub speed_out_of_sight: Option<f64> = None, "m/s";
        /// A robot that announces its course is assumed to deviate from its velocity by at most this, or to brake.
        pub robot_deviation: f64 = 0.1, "m/s", 0.0..=5.0;
        /// Minimum time to contact while creeping inside the margin.
        pub creep_time: f64 = 1.0, "s", 0.1..=10.0;
        /// Distance kept from unseen floor in addition to the margin: odometry drifts, and cells are coarse.
        pub unseen_margin: f64 = 0.03, "m", 0.0..=0.5;
        /// Motor time constants allowed after braking until the robot is at rest: a first-order lag is at 2 % after four.
        pub lags_to_rest: f64 = 4.0, "", 0.0..=10.0;
        /// Radius of a person who may stand unseen behind a corner (a disc as wide as an adult's shoulders). A smaller one finds blind
        /// corners at narrower gaps and behind narrower surfaces.
        pub person_radius: f64 = 0.25, "m", 0.05..=1.0;
        /// Speed at which the robot creeps past a blind corner where no greater speed is slow enough: the corner never leaves, so nothing
        /// would end a stop.
        pub corner_speed: f64 = 0.1, "m/s", 0.01..=2.0;
    }
    check = |safety: &PassiveSafetySettings| {
        let speeds = [("speed_in_view", safety.speed_in_view), ("speed_out_of_sight", safety.speed_out_of_sight)];
        speeds.into_iter().try_for_each(|(key, speed)| speed.map_or(Ok(()), |speed| check(key, speed, "m/s", &(0.0..=20.0))))
    };
}

zenav_protocol::settings! {
    /// Local obstacle memory.
    pub struct LocalObstacleSettings {
        /// Within this distance, points that have left the field of view are remembered and beams are traced through the blind-spot grid.
        pub range: f64 = 3.0, "m", 0.5..=50.0;
        /// Minimum spacing of remembered points.
        pub spacing: f64 = 0.02, "m", 0.001..=0.5;
        /// Most points remembered; the oldest are dropped first.
        pub max_points: usize = 2048, "", 1..=100_000;
        /// After this long without a scan of a lidar, or one and a half of its periods if that is longer, a moving obstacle may have entered
        /// the blind spot unseen.
        pub scan_gap: f64 = 0.5, "s", 0.05..=10.0;
    }
}

zenav_protocol::settings! {
    /// Contact memory: what the robot touched and no beam shows.
    #[derive(Copy)]
    pub struct ContactMemorySettings {
        /// A touched surface is forgotten this long after the last contact: by then odometry has drifted, and the map has it.
        pub memory: f64 = 600.0, "s", 0.0..=86_400.0;
        /// What is only assumed of a surface is forgotten this long after the last contact: until then it may close a gap that is open.
        pub assumed: f64 = 60.0, "s", 0.0..=86_400.0;
    }
}

zenav_protocol::settings! {
    /// Blind-spot grid: floor known to be free where no lidar sees. The grid has 128 cells a side.
    #[derive(Copy)]
    pub struct BlindSpotGridSettings {
        /// Side of a cell.
        pub cell: f64 = 0.05, "m", 0.02..=0.5;
        /// A cell with a return is free again once beams of this many scans have passed through it: thin legs are hit only now and then.
        pub free_after: u8 = 10, "scans", 1..=255;
        /// Beams are traced up to this distance before their return.
        pub return_margin: f64 = 0.02, "m", 0.0..=0.5;
        /// Floor assumed free at the start, beyond the circumscribed circle; a round robot turns on the spot and needs none.
        pub start_margin: f64 = 0.16, "m", 0.0..=2.0;
    }
}

zenav_protocol::settings! {
    /// Scan reprojection: which returns of one scan do the beams of another pass through?
    #[derive(Copy)]
    pub struct ScanReprojectionSettings {
        /// A beam passes through a place if the beam and this many neighbours on either side are longer by the free depth.
        pub neighbours: usize = 2, "beams", 0..=20;
        /// Free depth in addition to range noise.
        pub depth: f64 = 0.03, "m", 0.0..=1.0;
        /// Free depth in standard deviations of range noise, as estimated from the scans.
        pub depth_sigmas: f64 = 1.5, "", 0.0..=20.0;
        /// A return is passed only if a point this many standard deviations of range noise behind it is passed too.
        pub point_sigmas: f64 = 2.5, "", 0.0..=20.0;
        /// Free depth for each metre of range: covers heading errors and the spacing of beams.
        pub depth_per_metre: f64 = 0.01, "m/m", 0.0..=0.2;
    }
}

zenav_protocol::settings! {
    /// Detection of moving obstacles.
    pub struct MovingObstacleSettings {
        /// Returns beyond this range are ignored.
        pub range: f64 = 3.5, "m", 0.5..=50.0;
        /// Reference scans that a new one is compared with.
        pub references: usize = 3, "", 1..=16;
        /// Minimum time between two reference scans.
        pub reference_period: f64 = 0.32, "s", 0.05..=5.0;
        /// Minimum width of a moving obstacle.
        pub least_width: f64 = 0.04, "m", 0.0..=1.0;
        /// Its minimum width in beam spacings at its range: an earlier scan may have missed a thinner obstacle.
        pub least_beams: f64 = 2.5, "", 0.0..=20.0;
        /// Minimum age of a reference scan that is searched for departed returns: by then the obstacle is clearly farther away.
        pub departed_after: f64 = 0.3, "s", 0.05..=5.0;
        /// A return this near to where something moved counts as moving too.
        pub turning_distance: f64 = 0.2, "m", 0.0..=2.0;
        /// For how long it does: an obstacle that turns round seems to rest.
        pub turning_secs: f64 = 1.0, "s", 0.0..=30.0;
        /// An obstacle last seen this near to the blind spot, plus its motion between two scans, may have entered it.
        pub beside_blind_spot: f64 = 0.3, "m", 0.0..=5.0;
        /// An obstacle that needs longer than this to reach the robot does not stop the outline from swinging into the blind spot.
        pub near_secs: f64 = 0.75, "s", 0.0..=10.0;
        /// An obstacle that needs longer than this does not stop the robot from driving straight into the blind spot.
        pub far_secs: f64 = 4.0, "s", 0.0..=60.0;
        /// An obstacle that entered the blind spot stops the outline from swinging into it for this long.
        pub memory: f64 = 10.0, "s", 0.0..=600.0;
        /// It stops the robot from driving straight into the blind spot for this long: a person may stand there, or lean on the robot.
        pub memory_backing: f64 = 60.0, "s", 0.0..=600.0;
        /// An obstacle that leaves the blind spot this much farther away than it could have moved still counts as the same one.
        pub reappearance_tolerance: f64 = 0.1, "m", 0.0..=2.0;
        /// Minimum spacing of the points of moving obstacles.
        pub spacing: f64 = 0.02, "m", 0.001..=0.5;
        /// Minimum spacing of the stored places where something moved or entered the blind spot.
        pub place_spacing: f64 = 0.1, "m", 0.01..=1.0;
    }
}

zenav_protocol::settings! {
    /// Tracks of moving obstacles.
    pub struct TrackingSettings {
        /// Returns beyond this range are not tracked.
        pub range: f64 = 9.0, "m", 0.5..=100.0;
        /// Standard deviation of an obstacle's center as seen in a scan: its far side is never seen.
        pub position_noise: f64 = 0.05, "m", 0.005..=1.0;
        /// Standard deviation of an obstacle's acceleration: how quickly a person turns or stops.
        pub acceleration: f64 = 2.0, "m/s²", 0.1..=20.0;
        /// Association gate: a track continues with a segment this near to its prediction, plus two standard deviations.
        pub gate: f64 = 0.35, "m", 0.05..=3.0;
        /// Anything wider than this is not a moving obstacle.
        pub widest: f64 = 1.3, "m", 0.1..=10.0;
        /// An obstacle slower than this is stationary.
        pub least_speed: f64 = 0.08, "m/s", 0.0..=2.0;
        /// An obstacle that has been stationary for this long is a static one.
        pub standing: f64 = 2.0, "s", 0.1..=60.0;
        /// A hidden track continues by prediction for this long.
        pub memory: f64 = 2.0, "s", 0.1..=60.0;
    }
}

zenav_protocol::settings! {
    /// Predictive control among moving obstacles.
    pub struct AvoidanceSettings {
        /// How far ahead moving obstacles are predicted.
        pub horizon: f64 = 4.8, "s", 1.0..=10.0;
        /// Distance kept from the predicted position of a moving obstacle.
        pub clearance: f64 = 0.25, "m", 0.0..=2.0;
        /// Additional distance for each second of prediction: people turn.
        pub clearance_per_second: f64 = 0.08, "m/s", 0.0..=1.0;
        /// Upper limit of the two together.
        pub clearance_most: f64 = 0.6, "m", 0.0..=3.0;
        /// The robot leaves the path of a moving obstacle this long before the obstacle arrives.
        pub lead: f64 = 1.2, "s", 0.0..=5.0;
        /// Distance kept from the path of a robot that announces its course.
        pub robot_clearance: f64 = 0.15, "m", 0.0..=2.0;
        /// The robot leaves the path of such a robot this long before it arrives.
        pub robot_lead: f64 = 0.4, "s", 0.0..=5.0;
        /// A robot that must give way is expected to have done so after this time; nearer predictions of it are avoided all the same.
        pub robot_minded: f64 = 2.5, "s", 0.0..=10.0;
        /// Distance from the plan's reference at which the plan is discarded while the robot gives way.
        pub off_track: f64 = 3.0, "m", 0.1..=20.0;
    }
}

zenav_protocol::settings! {
    /// Right of way: where the robot waits for other robots.
    #[derive(Copy)]
    pub struct RightOfWaySettings {
        /// Two robots meet where the discs around their outlines come nearer than this.
        pub clearance: f64 = 0.3, "m", 0.15..=5.0;
        /// The robot goes first if it reaches each place of a crossing this long before the other robot, because it may be slower than its
        /// plan; 1 s longer from rest. At most `planning.space_time.before`, or the robot waits on the paths that are planned past others.
        pub lead: f64 = 1.5, "s", 0.0..=20.0;
        /// The robot follows if the other robot has left each place this long before. At most `planning.space_time.after`.
        pub others_lead: f64 = 0.8, "s", 0.0..=20.0;
        /// Two robots can pass each other where the floor is this much wider than the discs around both.
        pub passing_room: f64 = 0.2, "m", 0.0..=2.0;
    }
}

zenav_protocol::settings! {
    /// Pose estimator.
    pub struct EstimatorSettings {
        /// Standard deviation of the start position.
        pub start_std: f64 = 0.05, "m", 0.0001..=10.0;
        /// Standard deviation of the start heading.
        pub start_yaw_std: f64 = 0.05, "rad", 0.0001..=3.2;
        /// Wheels that have not turned for this long are at rest: the gyro then measures its own bias.
        pub still_after: f64 = 0.5, "s", 0.05..=10.0;
        /// After this many rejected measurements in a row the filter doubts its estimate instead of the sensor.
        pub doubt_after: u32 = 25, "", 1..=10000;
        /// After this many corrections in a row that contradict the estimate and agree with each other the filter doubts its estimate.
        pub contradicted_by: u32 = 3, "", 1..=10000;
        /// Random walk of a wheel beyond the encoder's own noise (slip, floor), for each metre rolled. Assumed: 1 mm after a metre.
        pub slip: f64 = 1e-6, "m²/m", 0.0..=0.01;
        /// Share of the forward variance that acts sideways.
        pub sideways_share: f64 = 1e-3, "", 0.0..=1.0;
        /// Standard deviation of a place on the map that corrections refer to: all corrections there share this error.
        pub map_std: f64 = 0.006, "m", 0.0..=1.0;
        /// Random walk of the map that corrections refer to, per square root of a metre: places 4 m apart are known to 1 cm relative to
        /// each other.
        pub map_walk: f64 = 0.005, "m/sqrt(m)", 0.0..=1.0;
        /// The same for its heading.
        pub map_turn_walk: f64 = 0.0015, "rad/sqrt(m)", 0.0..=1.0;
        /// Standard deviation of the gyro's bias at the start. Small MEMS gyros: up to about 1 degree per second.
        pub bias_std: f64 = 0.01, "rad/s", 0.0..=1.0;
        /// Random walk of the gyro's bias (fitted to constant biases, NEES 3).
        pub bias_walk: f64 = 1e-11, "(rad/s)²/s", 0.0..=0.01;
        /// Standard deviation of a wheel's radius from its nominal value, as a share.
        pub radius_std: f64 = 0.01, "", 0.0..=0.5;
        /// The same for the wheel separation.
        pub separation_std: f64 = 0.02, "", 0.0..=0.5;
        /// Random walk of the wheel radii and the wheel separation.
        pub wheel_walk: f64 = 1e-10, "1/s", 0.0..=0.01;
        /// After this long without wheel angles the robot is assumed to have moved anywhere within its top speed.
        pub encoder_timeout: f64 = 0.3, "s", 0.02..=10.0;
        /// Averaging time of the velocity: encoder steps are coarse against one tick.
        pub velocity_smoothing: f64 = 0.05, "s", 0.001..=5.0;
    }
}

zenav_protocol::settings! {
    /// Standing still to learn the gyro's bias, where neither compass nor GPS nor anything in sight gives the heading.
    #[derive(Copy)]
    pub struct SettlingSettings {
        /// The bias is known well enough if it bends the rest of the plan by at most this share of its length (one standard deviation).
        pub share: f64 = 0.01, "", 0.0001..=1000.0;
        /// Longest single stop (below the mission's time without progress).
        pub longest: f64 = 8.0, "s", 0.0..=9.0;
        /// Distance driven before another stop.
        pub apart: f64 = 10.0, "m", 1.0..=1000.0;
    }
}

zenav_protocol::settings! {
    /// Telemetry.
    pub struct TelemetrySettings {
        /// Period of the state (contract: 10 Hz).
        pub state_period: f64 = 0.1, "s", 0.02..=1.0;
        /// Period at which the robot announces its course to other robots.
        pub intent_period: f64 = 0.2, "s", 0.02..=1.0;
        /// A robot with nothing to drive to stops announcing its course after this: it is then an obstacle like any other.
        pub intent_parked: f64 = 2.0, "s", 0.0..=60.0;
        /// Period of markers.
        pub marker_period: f64 = 0.2, "s", 0.02..=10.0;
        /// Period of slowly changing messages (battery, bumper).
        pub slow_period: f64 = 1.0, "s", 0.1..=60.0;
    }
}

zenav_protocol::settings! {
    /// Narrow links: how much of its sensor data the robot sends.
    pub struct UplinkSettings {
        /// Longest queueing time of messages, on top of the link's round trip, before the robot sends fewer scans, poses and readings.
        pub longest_queue: f64 = 0.25, "s", 0.02..=10.0;
    }
}

impl EdgeSettings {
    /// Age of a lidar scan at which this robot stops, s.
    #[must_use]
    pub fn scan_timeout(&self, model: &RobotModel) -> f64 {
        let needed = slowest(model, |lidar| lidar.latency + 2.0 / lidar.rate_hz);
        self.collision_monitor
            .scan_timeout
            .unwrap_or(needed.max(STOPPED_AFTER.0))
    }

    /// Time from the last scan until this robot, with this control period (s), is at rest, s.
    ///
    /// ```
    /// use zenav_edge::EdgeSettings;
    ///
    /// let (settings, mut tiago) = (EdgeSettings::default(), zenav_fixtures::robot("tiago"));
    /// assert_eq!(settings.rest_after_silence(&tiago, 0.02), 0.7);
    /// // Four time constants of its motors alone are 1.2 s.
    /// tiago.drive.motor_lag = 0.3;
    /// assert!((1.6..1.8).contains(&settings.rest_after_silence(&tiago, 0.02)));
    /// ```
    #[must_use]
    pub fn rest_after_silence(&self, model: &RobotModel, tick: f64) -> f64 {
        let needed = self.silence_until_rest(model, tick, SPEED_KEPT.0);
        self.collision_monitor
            .rest_after_silence
            .unwrap_or(needed.max(STOPPED_AFTER.1))
    }

    /// Time from a scan until a robot is at rest that drives at this share of its top speed until the next one is due, s.
    fn silence_until_rest(&self, model: &RobotModel, tick: f64, share: f64) -> f64 {
        let drive = &model.drive;
        let braking = share * drive.top_speed() / drive.hard_braking;
        slowest(model, |lidar| 1.0 / lidar.rate_hz)
            + tick
            + self.passive_safety.lags_to_rest * drive.motor_lag
            + braking
    }

    /// Whether what is set suits this robot, with this control period, s.
    ///
    /// ```
    /// use zenav_edge::EdgeSettings;
    ///
    /// let (mut settings, tiago) = (EdgeSettings::default(), zenav_fixtures::robot("tiago"));
    /// settings.collision_monitor.rest_after_silence = Some(0.3);
    /// assert_eq!(
    ///     settings.check_for(&tiago, 0.02).unwrap_err().to_string(),
    ///     "`collision_monitor.rest_after_silence` is 0.3: expected at least 0.43 s, for the robot's lidars and motors"
    /// );
    /// ```
    ///
    /// # Errors
    /// The first value with which the robot would not move, or hardly, by its key, and the least value that works.
    pub fn check_for(&self, model: &RobotModel, tick: f64) -> Result<(), OutOfBounds> {
        let monitor = &self.collision_monitor;
        let scan = slowest(model, |lidar| lidar.latency + 1.0 / lidar.rate_hz) + tick;
        let rest = self.silence_until_rest(model, tick, SPEED_KEPT.1);
        for (key, value, least) in [
            ("scan_timeout", monitor.scan_timeout, scan),
            ("rest_after_silence", monitor.rest_after_silence, rest),
        ] {
            if let Some(value) = value.filter(|value| *value < least) {
                let least = (100.0 * least).ceil() / 100.0;
                let expected = format!("at least {least} s, for the robot's lidars and motors");
                return Err(OutOfBounds::unlike(key, value, expected).within("collision_monitor"));
            }
        }
        Ok(())
    }
}

/// The longest of a time of each of the robot's lidars, s.
fn slowest(model: &RobotModel, time: impl Fn(&LidarModel) -> f64) -> f64 {
    model.all_lidars().map(|(_, lidar)| time(lidar)).fold(0.0, f64::max)
}

impl BlindSpotGridSettings {
    /// Largest distance that the grid covers around the robot, m: a bit less than half its width.
    #[must_use]
    pub fn range(&self) -> f64 {
        0.48 * f64::from(SIDE) * self.cell
    }
}

impl AvoidanceSettings {
    /// Distance kept from the predicted position of a moving obstacle `secs` ahead, m.
    #[must_use]
    pub fn clearance_after(&self, secs: f64) -> f64 {
        (self.clearance + self.clearance_per_second * secs).min(self.clearance_most)
    }
}

impl PassiveSafetySettings {
    /// Assumed speed of moving obstacles in view, m/s, for a robot with this top speed.
    #[must_use]
    pub fn speed_in_view(&self, top_speed: f64) -> f64 {
        self.speed_in_view.unwrap_or(top_speed)
    }

    /// Assumed speed of moving obstacles out of sight, m/s, for a robot with this top speed.
    #[must_use]
    pub fn speed_out_of_sight(&self, top_speed: f64) -> f64 {
        self.speed_out_of_sight.unwrap_or(top_speed.max(WALKING))
    }

    /// Assumed speed of people who come out from behind corners, m/s, for a robot with this top speed.
    #[must_use]
    pub fn speed_round_corners(&self, top_speed: f64) -> f64 {
        self.speed_out_of_sight.unwrap_or(top_speed.min(ROUND_CORNERS))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::robot::SHIPPED;
    use zenav_protocol::settings::Settings;

    #[test]
    fn the_defaults_are_within_their_bounds_and_every_setting_has_its_own_key() {
        EdgeSettings::default().check().unwrap();
        let mut keys: Vec<String> = EdgeSettings::rows().into_iter().map(|row| row.key).collect();
        let count = keys.len();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), count);
    }

    #[test]
    fn a_value_that_makes_no_sense_is_refused_with_its_key() {
        for (text, key) in [
            (r#"{"lease": {"lost_after": 0.2}}"#, "lease.lost_after"),
            (
                r#"{"passive_safety": {"speed_out_of_sight": -1.0}}"#,
                "passive_safety.speed_out_of_sight",
            ),
            (r#"{"local_obstacles": {"range": 5.0}}"#, "local_obstacles.range"),
            (
                r#"{"collision_monitor": {"scan_timeout": 60.0}}"#,
                "collision_monitor.scan_timeout",
            ),
        ] {
            let settings: EdgeSettings = serde_json::from_str(text).unwrap();
            assert!(settings.check().unwrap_err().to_string().contains(key), "{text}");
        }
        assert!(serde_json::from_str::<EdgeSettings>(r#"{"guard": {"margin": 1.0}}"#).is_err());
    }

    #[test]
    fn a_robot_is_at_rest_as_soon_after_the_last_scan_as_its_lidars_and_motors_allow() {
        const TICK: f64 = 0.02;
        let settings = EdgeSettings::default();
        for (name, _) in SHIPPED {
            let model = zenav_fixtures::robot(name);
            assert_eq!(settings.scan_timeout(&model), 1.0, "{name}");
            assert_eq!(settings.rest_after_silence(&model, TICK), 0.7, "{name}");
        }
        let tiago = zenav_fixtures::robot("tiago");
        let braking = 0.9 * tiago.drive.top_speed() / tiago.drive.hard_braking;
        for (lag, rate, timeout) in [(0.3, 10.0, 1.0), (1.0, 10.0, 1.0), (0.05, 2.0, 1.0), (0.05, 1.0, 2.0)] {
            let mut model = tiago.clone();
            model.drive.motor_lag = lag;
            model.lidar.as_mut().unwrap().rate_hz = rate;
            let rest = settings.rest_after_silence(&model, TICK);
            assert!(
                (rest - (1.0 / rate + TICK + 4.0 * lag + braking)).abs() < 1e-9,
                "{lag} {rate}: {rest}"
            );
            assert_eq!(settings.scan_timeout(&model), timeout);
        }
    }

    #[test]
    fn a_value_at_which_the_robot_would_hardly_move_is_refused_with_the_least_that_works() {
        let set = |text| serde_json::from_str::<EdgeSettings>(text).unwrap();
        let mut model = zenav_fixtures::robot("tiago");
        model.lidar.as_mut().unwrap().rate_hz = 1.0;
        for (text, least) in [
            (
                r#"{"collision_monitor": {"rest_after_silence": 0.7}}"#,
                "`collision_monitor.rest_after_silence` is 0.7: expected at least 1.33 s",
            ),
            (
                r#"{"collision_monitor": {"scan_timeout": 0.9}}"#,
                "`collision_monitor.scan_timeout` is 0.9: expected at least 1.02 s",
            ),
        ] {
            let settings = set(text);
            settings.check().unwrap();
            let error = settings.check_for(&model, 0.02).unwrap_err().to_string();
            assert!(error.starts_with(least), "{error}");
        }
        let works = set(r#"{"collision_monitor": {"rest_after_silence": 1.33, "scan_timeout": 1.02}}"#);
        works.check_for(&model, 0.02).unwrap();
        EdgeSettings::default().check_for(&model, 0.02).unwrap();
    }
}
