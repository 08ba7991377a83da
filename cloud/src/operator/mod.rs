//! Operator. Under which epoch does a person's command change something of a robot?
//!
//! What changes a robot, its map or what is drawn on it carries the epoch of the lease in force. What a robot that drives need not notice is
//! changed under the epoch of whoever commands ([`in_force`]). What pulls the ground from under its plan is changed under the operator's own
//! lease ([`at_rest`]): the robot is at rest then, and its mission plans anew once the lease is given back.
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

/// A robot that is there publishes its state within this time.
const STATE_WITHIN: Duration = Duration::from_millis(1500);
/// Pause before a refused epoch is tried again: others have not heard of the newest grant yet.
const AGAIN: Duration = Duration::from_millis(100);

/// An epoch under which a robot may be commanded, and the lease where it is our own.
#[derive(Debug)]
pub struct Authority {
    /// The epoch that requests carry; `None` while there is no robot that could be commanded.
    pub epoch: Option<u64>,
    session: Option<LeaseSession>,
}

impl Authority {
    /// The operator's lease: the one that `holder` has already, a new one otherwise.
    ///
    /// # Errors
    /// When somebody else operates the robot, or it does not answer.
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

    /// Gives the lease back, where it was taken for this.
    pub async fn release(self) {
        if let Some(session) = self.session {
            // It ends by itself when nobody renews it.
            let _ = session.release().await;
        }
    }
}

/// The robot's newest state; `None` for a robot that is not there.
async fn heard(bus: &Bus, robot: &str) -> Result<Option<EdgeState>, AskError> {
    let mut states = bus.latest(&topics::STATE, &[robot])?;
    let next = timeout(STATE_WITHIN, states.next()).await;
    Ok(next.ok().flatten().map(|received| received.message))
}

/// Asks under the epoch of the lease in force, whoever holds it; again while that is changing.
///
/// # Errors
/// The ask's own.
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

/// As [`in_force`], for what the robot itself refuses without a lease: where nobody holds it, the operator's is taken for this.
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

/// Asks under the operator's lease, which is given back at once: the robot comes to rest for it.
///
/// # Errors
/// As [`Authority::acquire`], or the ask's own.
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
            // Whoever is asked has not heard of the grant yet.
            Err(AskError::Refused(Refusal::WrongEpoch { .. })) if Instant::now() < until => sleep(AGAIN).await,
            answer => break answer,
        }
    };
    authority.release().await;
    answer
}
