//! Leadership. Will any of the orchestrators that run keep a robot's goals? The robot lists the stores that may ([`LeaseState::leader`]);
//! a request to a mission is refused with `NotLeader` until one of them leads.

use std::time::Duration;

use tokio::time::{Instant, timeout};
use zenav_protocol::bus::{AskError, Bus, Latest};
use zenav_protocol::messages::{EdgeState, InfoReply, InfoRequest, LeaseState, Refusal};
use zenav_protocol::topics::{self, Ask, Message};

/// A robot that has had no orchestrator that may lead for so long is taken to get none: one may be starting.
const GRACE: Duration = Duration::from_secs(3);
/// Longest wait for the robot's state, and for the missions' names.
const WORD: Duration = Duration::from_millis(500);
/// Pause between two looks.
const PAUSE: Duration = Duration::from_millis(250);
/// What helps if no orchestrator that runs may lead.
pub(crate) const CURE: &str = "`zenav doctor` says which may; `zenav lease forget` if it will not come back";

/// Asks the robot's mission. If none of the missions that run may lead, this fails after some seconds instead of at the deadline.
///
/// # Errors
/// Those of [`Bus::ask`].
pub(crate) async fn ask<Q: Message, R: Message>(
    bus: &Bus,
    ask: &Ask<Q, R>,
    robot: &str,
    request: &Q,
    within: Duration,
) -> Result<R, AskError> {
    let chunks = [robot];
    tokio::select! {
        answer = bus.ask(ask, &chunks, request, within) => answer,
        () = never_led(bus, robot) => Err(AskError::Refused(Refusal::NotLeader)),
    }
}

/// Waits until none of the missions that have answered for some seconds may lead the robot.
pub(crate) async fn never_led(bus: &Bus, robot: &str) {
    let Ok(mut states) = bus.latest(&topics::STATE, &[robot]) else {
        return std::future::pending().await;
    };
    let mut since = None;
    loop {
        if look(bus, robot, &mut states).await.is_some() {
            let since: Instant = *since.get_or_insert_with(Instant::now);
            if since.elapsed() >= GRACE {
                return;
            }
        } else {
            since = None;
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// The stores that may lead the robot, if none of the missions that run has one of them.
pub(crate) async fn missing(bus: &Bus, robot: &str) -> Option<Vec<String>> {
    look(bus, robot, &mut bus.latest(&topics::STATE, &[robot]).ok()?).await
}

async fn look(bus: &Bus, robot: &str, states: &mut Latest<EdgeState>) -> Option<Vec<String>> {
    let lease = timeout(WORD, states.next()).await.ok()??.message.lease;
    // Most robots have a leader: then nobody has to be asked.
    if lease.leader_live {
        return None;
    }
    let answers = bus.ask_all(&topics::CLOUD_INFO, &[robot], &InfoRequest {}, WORD).await;
    let missions: Vec<InfoReply> = answers
        .ok()?
        .into_iter()
        .filter_map(|answer| answer.result.ok())
        .collect();
    of(lease, &missions)
}

/// As [`missing`], from the robot's lease and the missions' words.
fn of(lease: LeaseState, missions: &[InfoReply]) -> Option<Vec<String>> {
    let may_lead = lease.leader.filter(|_| !lease.leader_live)?.caught_up;
    let leads =
        |mission: &InfoReply| mission.leads || mission.store.as_ref().is_some_and(|store| may_lead.contains(store));
    // Without any, one may be starting.
    (!missions.is_empty() && !missions.iter().any(leads)).then_some(may_lead)
}

#[cfg(test)]
mod tests {
    use zenav_protocol::messages::Leader;

    use super::*;

    fn lease(caught_up: &[&str], leader_live: bool) -> LeaseState {
        LeaseState {
            leader: Some(Leader {
                store: "anna".to_owned(),
                epoch: 3,
                caught_up: caught_up.iter().map(|store| (*store).to_owned()).collect(),
                revision: 1,
            }),
            leader_live,
            ..LeaseState::default()
        }
    }

    fn mission(store: &str, leads: bool) -> InfoReply {
        InfoReply {
            store: Some(store.to_owned()),
            leads,
            ..InfoReply::default()
        }
    }

    #[test]
    fn a_robot_has_no_leader_to_come_if_no_mission_that_runs_has_a_store_that_may_lead() {
        let lost = lease(&["anna"], false);
        assert_eq!(
            of(lost.clone(), &[mission("bert", false)]),
            Some(vec!["anna".to_owned()])
        );
        // One may be starting, or may lead, or leads already.
        assert_eq!(of(lost.clone(), &[]), None);
        assert_eq!(
            of(lost.clone(), &[mission("bert", false), mission("anna", false)]),
            None
        );
        assert_eq!(of(lost, &[mission("bert", true)]), None);
        assert_eq!(of(lease(&["anna"], true), &[mission("bert", false)]), None);
        assert_eq!(of(LeaseState::default(), &[mission("bert", false)]), None);
    }
}
