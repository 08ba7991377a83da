//! Body. What must a robot's hardware provide? Readings, and a way to set wheel speeds.

use thiserror::Error;
use zenav_protocol::readings::Readings;

/// A robot's hardware, real or simulated.
///
/// ```
/// use zenav_edge::{Body, BodyError};
/// use zenav_protocol::{readings::Readings, time::Stamp};
///
/// /// A base whose wheels turn exactly as told.
/// struct Ideal { angles: [f64; 2], speeds: [f64; 2], now: Stamp }
///
/// impl Body for Ideal {
///     fn read(&mut self) -> Result<Readings, BodyError> {
///         self.now = self.now.plus_secs(0.02);
///         self.angles = [0, 1].map(|side| self.angles[side] + 0.02 * self.speeds[side]);
///         Ok(Readings { wheels: self.angles, ..Readings::new(self.now) })
///     }
///     fn drive(&mut self, wheels: [f64; 2]) -> Result<(), BodyError> {
///         self.speeds = wheels;
///         Ok(())
///     }
/// }
///
/// let mut body = Ideal { angles: [0.0; 2], speeds: [0.0; 2], now: Stamp::ZERO };
/// body.drive([1.0, 2.0])?;
/// assert_eq!(body.read()?.wheels, [0.02, 0.04]);
/// # Ok::<(), BodyError>(())
/// ```
pub trait Body: Send {
    /// The readings of this control tick; the last ones again if there are no others, but for at most 0.2 s, or two ticks if those are
    /// longer: then the caller brakes. Those from before the last ones are refused, and those far ahead of them until several in a row
    /// continue from there ([`BodyClock`](crate::body_clock::BodyClock)). A simulated body first advances its world by one tick.
    ///
    /// # Errors
    /// [`BodyError`] when the hardware does not answer; the caller brakes and tries again at the next tick.
    fn read(&mut self) -> Result<Readings, BodyError>;

    /// Sets the wanted wheel speeds (left, right; rad/s) until the next call. Hardware must stop by itself if this is not called for 0.1 s.
    ///
    /// # Errors
    /// [`BodyError`] when the hardware does not answer.
    fn drive(&mut self, wheels: [f64; 2]) -> Result<(), BodyError>;

    /// Whether [`read`](Self::read) itself waits for the next tick, a few of them at most; otherwise the caller keeps time.
    fn gives_the_pace(&self) -> bool {
        false
    }

    /// Whether [`read`](Self::read) itself refuses stamps that cannot be the body's true time; otherwise the caller does.
    fn judges_stamps(&self) -> bool {
        false
    }
}

/// The hardware did not answer.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("body: {0}")]
pub struct BodyError(pub String);
