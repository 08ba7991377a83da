//! Operator. The epoch under which an operator's command changes a robot.
//!
//! Every change of a robot, its map or the annotations on it carries the epoch of the lease in force. A change that a driving robot need
//! not notice is made under the present holder's epoch ([`in_force`]). A change that invalidates its plan is made under the operator's own
//! lease ([`at_rest`]): the robot is then at rest, and its mission replans once the lease is released.
//!
//! | file | answers |
//! |---|---|
//! | `lease_session` | how is the operator's lease kept while it is needed? |

mod lease_session;

use std::time::Duration;

use tokio::time::{Instant, sleep, timeout};
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{EdgeState, LeaseRole, Refusal};
use zenav_protocol::topics;

pub use lease_session::{LeaseSession, ask_lease};

/// A robot that is present publishes its state within this time.
const STATE_WITHIN: Duration = Duration::from_millis(1500);
/// Pause before a refused epoch is tried again: other parts may not know the newest grant yet.
const AGAIN: Duration = Duration::from_millis(100);

/// An epoch under which a robot may be commanded, and our own lease if we hold it.
#[derive(Debug)]
pub struct Authority {
    /// The epoch for requests; `None` while there is no robot to command.
    pub epoch: Option<u64>,
    session: Option<LeaseSession>,
}

impl Authority {
    /// The operator's lease: the one that `holder` already has, otherwise a new one.
    ///
    /// # Errors
    /// If another operator holds the robot, or it does not answer.
    pub async fn acquire(bus: &Bus, robot: &str, holder: &str, within: Duration) -> Result<Self, AskError> {
        let Some(state) = heard(bus, robot).await? else {
            return Ok(Self {
                epoch: None,
                session: None,
            });
        };
        let lease = state.lease;
        let ours = lease.live && lease.role == Some(LeaseRole::Operator) && lease.holder.as_deref() == Some(holder);
        if ours {
            return Ok(Self {
                epoch: Some(lease.epoch),
                session: None,
            });
        }
        let session = LeaseSession::acquire(bus, robot, holder, within).await?;
        Ok(Self {
            epoch: Some(session.grant.epoch),
            session: Some(session),
        })
    }

    /// Releases the lease if it was acquired here.
    pub async fn release(self) {
        if let Some(session) = self.session {
            // Without renewal the lease expires by itself.
            let _ = session.release().await;
        }
    }
}

/// The robot's newest state; `None` if the robot is absent.
async fn heard(bus: &Bus, robot: &str) -> Result<Option<EdgeState>, AskError> {
    let mut states = bus.latest(&topics::STATE, &[robot])?;
    let next = timeout(STATE_WITHIN, states.next()).await;
    Ok(next.ok().flatten().map(|received| received.message))
}

/// Makes a request under the epoch of the lease in force, whoever holds it; retries while the epoch is changing.
///
/// # Errors
/// Those of the request.
pub async fn in_force<R, F>(
    bus: &Bus,
    robot: &str,
    within: Duration,
    ask: impl Fn(Option<u64>) -> F,
) -> Result<R, AskError>
where
    F: Future<Output = Result<R, AskError>>,
{
    let until = Instant::now() + within;
    loop {
        let lease = heard(bus, robot).await?.map(|state| state.lease);
        let epoch = lease.filter(|lease| lease.live).map(|lease| lease.epoch);
        match ask(epoch).await {
            Err(AskError::Refused(Refusal::WrongEpoch { .. })) if Instant::now() < until => sleep(AGAIN).await,
            answer => return answer,
        }
    }
}

/// As [`in_force`], for changes that the robot itself refuses without a lease: if nobody holds it, the operator's lease is taken.
///
/// # Errors
/// As [`in_force`] and [`Authority::acquire`].
pub async fn in_force_or_own<R, F>(
    bus: &Bus,
    robot: &str,
    holder: &str,
    within: Duration,
    ask: impl Fn(Option<u64>) -> F,
) -> Result<R, AskError>
where
    F: Future<Output = Result<R, AskError>>,
{
    let is_live = heard(bus, robot).await?.is_some_and(|state| state.lease.live);
    if is_live {
        in_force(bus, robot, within, ask).await
    } else {
        at_rest(bus, robot, holder, within, ask).await
    }
}

/// Makes a request under the operator's lease and releases it at once. The robot comes to rest for it.
///
/// # Errors
/// As [`Authority::acquire`], or those of the request.
pub async fn at_rest<R, F>(
    bus: &Bus,
    robot: &str,
    holder: &str,
    within: Duration,
    ask: impl Fn(Option<u64>) -> F,
) -> Result<R, AskError>
where
    F: Future<Output = Result<R, AskError>>,
{
    let authority = Authority::acquire(bus, robot, holder, within).await?;
    let until = Instant::now() + within;
    let answer = loop {
        match ask(authority.epoch).await {
            // The recipient does not know the grant yet.
            Err(AskError::Refused(Refusal::WrongEpoch { .. })) if Instant::now() < until => sleep(AGAIN).await,
            answer => break answer,
        }
    };
    authority.release().await;
    answer
}
