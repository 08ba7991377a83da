//! Remote body. How does a robot in another process become a [`Body`]? Readings and wheel speeds go over the bus: to a world server for
//! many robots (`zenav sim serve`), or to a hardware driver in any language.

use std::hash::{BuildHasher, RandomState};
use std::time::{Duration, Instant};

use thiserror::Error;
use tokio::runtime::Handle;
use tokio::sync::watch;
use zenav_protocol::bus::{AskError, Bus, BusConfig, BusError, Subscription};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{AttachReply, AttachRequest, WheelSpeeds};
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use crate::body::{Body, BodyError};
use crate::body_clock::BodyClock;
use crate::settings::BodySettings;

/// Most readings that wait in the bus.
const QUEUE: usize = 32;
/// Wall time without readings after which the body counts as silent.
const SILENCE: Duration = Duration::from_millis(200);
/// Wall time for a world server to answer before it is asked again over a new session.
const ATTACH: Duration = Duration::from_secs(3);

/// A body on the other side of the bus.
pub struct RemoteBody {
    readings: Subscription<Readings>,
    wheels: watch::Sender<WheelSpeeds>,
    clock: BodyClock,
    stamp: Stamp,
    edge: u64,
    runtime: Handle,
}

/// A robot of a world server, and the session that it was attached over.
pub struct Attached {
    /// The session.
    pub bus: Bus,
    /// The robot's body.
    pub body: RemoteBody,
    /// The world server's reply.
    pub reply: AttachReply,
}

/// Why no body was attached.
#[derive(Debug, Error)]
pub enum AttachError {
    /// No world server answers, or it does not accept the robot.
    #[error("cannot attach to a world server: {0}")]
    Ask(#[from] AskError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The world's tick or speed is not a positive number.
    #[error("world {0} has ticks of {1} s at {2} times real time: expected positive numbers")]
    Pace(String, f64, f64),
}

impl RemoteBody {
    /// Adds a robot to the world served on a bus, or takes over one that is already in it. While no world is served it waits, and logs
    /// that. In a Tokio runtime only.
    ///
    /// # Errors
    /// [`AttachError`]: the world does not accept the robot, or another edge drives it.
    pub async fn attach(
        config: &BusConfig,
        robot: &Id,
        model: &RobotModel,
        start: Option<Pose2>,
        settings: &BodySettings,
    ) -> Result<Attached, AttachError> {
        let request = AttachRequest {
            robot: robot.to_string(),
            model: model.clone(),
            start,
            // Below 2^53: every JSON reader can hold it exactly.
            edge: RandomState::new().hash_one(std::process::id()) >> 11,
        };
        loop {
            let bus = Bus::open(config.clone()).await?;
            match Self::ask_for(&bus, &request, settings).await {
                Ok((body, reply)) => {
                    if let Some(wanted) = start.filter(|wanted| wanted.distance(&reply.start) > 1e-3) {
                        let here = reply.start;
                        tracing::warn!(
                            "robot `{robot}` is in the world already, at ({:.2}, {:.2}): its start ({:.2}, {:.2}) is ignored",
                            here.x,
                            here.y,
                            wanted.x,
                            wanted.y
                        );
                    }
                    return Ok(Attached { bus, body, reply });
                }
                // Zenoh takes a router that comes up within 0.1 s of another one's leaving for that one, and tells it nothing: a link
                // without any traffic may be such a case.
                Err(AttachError::Ask(AskError::Timeout { .. })) => {
                    tracing::info!(connect = config.connect.join(", "), "waiting for a world server");
                    bus.close().await;
                }
                Err(error) => {
                    bus.close().await;
                    return Err(error);
                }
            }
        }
    }

    async fn ask_for(
        bus: &Bus,
        request: &AttachRequest,
        settings: &BodySettings,
    ) -> Result<(Self, AttachReply), AttachError> {
        let reply: AttachReply = bus.ask(&topics::ATTACH, &[], request, ATTACH).await?;
        let is_pace = |value: f64| value.is_finite() && value > 0.0;
        if !(is_pace(reply.tick_secs) && is_pace(reply.speed) && reply.start.is_finite()) {
            return Err(AttachError::Pace(reply.world, reply.tick_secs, reply.speed));
        }
        Ok((Self::new(bus, &request.robot, request.edge, settings)?, reply))
    }

    /// The body that publishes this robot's readings; `edge` identifies the edge that drives it. In a Tokio runtime only.
    ///
    /// # Errors
    /// [`BusError`] when its topics cannot be declared.
    pub fn new(bus: &Bus, robot: &str, edge: u64, settings: &BodySettings) -> Result<Self, BusError> {
        let readings = bus.subscribe(&topics::READINGS, &[robot], QUEUE)?;
        let publisher = bus.publisher(&topics::WHEELS, &[robot])?;
        let still = WheelSpeeds {
            stamp: Stamp::ZERO,
            wheels: [0.0; 2],
            edge,
        };
        let (wheels, mut wanted) = watch::channel(still);
        tokio::spawn(async move {
            while wanted.changed().await.is_ok() {
                let speeds = *wanted.borrow_and_update();
                publisher.put(&speeds);
            }
        });
        Ok(Self {
            readings,
            wheels,
            clock: BodyClock::new(settings.longest_step),
            stamp: Stamp::ZERO,
            edge,
            runtime: Handle::current(),
        })
    }
}

impl Body for RemoteBody {
    fn read(&mut self) -> Result<Readings, BodyError> {
        let begun = Instant::now();
        let mut refused = None;
        // The control thread itself waits and decodes: Zenoh's thread wakes it directly, without another task switch.
        let mut readings = loop {
            let (readings, left) = (&mut self.readings, SILENCE.saturating_sub(begun.elapsed()));
            let heard = self
                .runtime
                .block_on(async { tokio::time::timeout(left, readings.next()).await });
            match heard {
                Ok(Some(received)) => match self.clock.judge(received.message.stamp) {
                    Ok(()) => break received.message,
                    Err(not_now) => refused = Some(not_now),
                },
                Ok(None) => {
                    std::thread::sleep(SILENCE);
                    return Err(BodyError("the bus is closed".to_owned()));
                }
                Err(_) => {
                    let silent = || format!("no readings for {SILENCE:?}");
                    return Err(BodyError(refused.map_or_else(silent, |not_now| not_now.to_string())));
                }
            }
            if begun.elapsed() >= SILENCE
                && let Some(not_now) = refused
            {
                return Err(BodyError(not_now.to_string()));
            }
        };
        while let Some(received) = self.readings.try_next() {
            if self.clock.judge(received.message.stamp).is_ok() {
                readings = readings.followed_by(received.message);
            }
        }
        self.stamp = readings.stamp;
        Ok(readings)
    }

    fn drive(&mut self, wheels: [f64; 2]) -> Result<(), BodyError> {
        let Self { stamp, edge, .. } = *self;
        self.wheels.send_replace(WheelSpeeds { stamp, wheels, edge });
        Ok(())
    }

    fn gives_the_pace(&self) -> bool {
        true
    }

    fn judges_stamps(&self) -> bool {
        true
    }
}
