//! Changes. Requests that change a robot in this user's name, by the rules of [`zenav_cloud::operator`].

use std::time::Duration;

use zenav_cloud::operator;
use zenav_protocol::bus::{AskError, Bus};

use super::holder;
use crate::failure::Failure;

pub(crate) use operator::Authority;

/// Asks under the epoch of the lease in force, whoever holds it.
///
/// # Errors
/// That of the ask.
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

/// Like [`in_force`]; if nobody holds the lease, acquires the operator's lease for the request.
///
/// # Errors
/// As [`in_force`], and a lease held by another holder.
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

/// Asks under the operator's lease and releases it at once: the robot stops for the request.
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
