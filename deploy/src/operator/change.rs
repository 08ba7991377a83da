//! Changes. In whose name does a command change something of a robot? In this user's, by the rules of [`zenav_cloud::operator`].

use std::time::Duration;

use zenav_cloud::operator;
use zenav_protocol::bus::{AskError, Bus};

use super::holder;
use crate::failure::Failure;

pub(crate) use operator::Authority;

/// Asks under the epoch of the lease in force, whoever holds it.
///
/// # Errors
/// The ask's own.
pub(crate) async fn in_force<R, F>(
    bus: &Bus,
    robot: &str,
    within: Duration,
    ask: impl Fn(Option<u64>) -> F,
) -> Result<R, Failure>
where
    F: Future<Output = Result<R, AskError>>,
{
    Ok(operator::in_force(bus, robot, within, ask).await?)
}

/// As [`in_force`]; where nobody holds the lease, the operator's is taken for this.
///
/// # Errors
/// As [`in_force`], and a lease that another one holds.
pub(crate) async fn in_force_or_own<R, F>(
    bus: &Bus,
    robot: &str,
    within: Duration,
    ask: impl Fn(Option<u64>) -> F,
) -> Result<R, Failure>
where
    F: Future<Output = Result<R, AskError>>,
{
    Ok(operator::in_force_or_own(bus, robot, &holder(), within, ask).await?)
}

/// Asks under the operator's lease, which is given back at once: the robot comes to rest for it.
///
/// # Errors
/// As [`in_force_or_own`].
pub(crate) async fn at_rest<R, F>(
    bus: &Bus,
    robot: &str,
    within: Duration,
    ask: impl Fn(Option<u64>) -> F,
) -> Result<R, Failure>
where
    F: Future<Output = Result<R, AskError>>,
{
    Ok(operator::at_rest(bus, robot, &holder(), within, ask).await?)
}
