//! Tests of the lease arbiter: who may command a robot.

use super::*;

fn beat(holder: &str, epoch: u64, counter: u64) -> Heartbeat {
    Heartbeat {
        holder: holder.to_owned(),
        epoch,
        counter,
        echo: None,
    }
}

fn request(holder: &str, role: LeaseRole, action: LeaseAction) -> LeaseRequest {
    LeaseRequest::new(holder, role, action, "r")
}

fn at(secs: f64) -> Stamp {
    Stamp::from_secs(secs)
}

const MISSION: LeaseRole = LeaseRole::Mission;
const TAKE: LeaseAction = LeaseAction::Acquire;

#[test]
fn two_missions_never_hold_the_lease_at_once() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 41, None);
    assert_eq!(
        arbiter.request(at(0.0), &request("a", MISSION, TAKE)),
        Ok(Granted {
            epoch: 42,
            holder_changed: true,
            round_trip: None,
        })
    );
    assert!(matches!(
        arbiter.request(at(0.9), &request("b", MISSION, TAKE)),
        Err(Refusal::Held { .. })
    ));
    assert_eq!(
        arbiter.request(at(1.5), &request("b", MISSION, TAKE)),
        Ok(Granted {
            epoch: 43,
            holder_changed: true,
            round_trip: None,
        })
    );
    assert!(
        !arbiter.renew(at(1.6), &beat("a", 42, 9)),
        "the old holder's heartbeat renews nothing"
    );
    assert!(!arbiter.admits(at(1.6), 42) && arbiter.admits(at(1.6), 43));
}

#[test]
fn a_lapsed_holder_must_ask_anew_and_gets_a_new_epoch() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter.request(at(0.0), &request("a", MISSION, TAKE)).unwrap();
    assert!(arbiter.renew(at(0.5), &beat("a", 1, 1)));
    assert!(
        !arbiter.renew(at(0.6), &beat("a", 1, 1)),
        "a replayed heartbeat renews nothing"
    );
    assert!(
        !arbiter.renew(at(3.0), &beat("a", 1, 2)),
        "a heartbeat after the lapse renews nothing"
    );
    assert_eq!(
        arbiter.request(at(3.0), &request("a", MISSION, TAKE)),
        Ok(Granted {
            epoch: 2,
            holder_changed: false,
            round_trip: None,
        })
    );
}

#[test]
fn a_command_renews_as_a_heartbeat_does_and_heartbeats_count_on() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter
        .request(at(0.0), &request("a", LeaseRole::Operator, TAKE))
        .unwrap();
    arbiter.heard(at(0.8));
    assert!(arbiter.is_live(at(1.7)));
    assert!(arbiter.renew(at(1.7), &beat("a", 1, 1)));
    arbiter.heard(at(3.0));
    assert!(!arbiter.is_live(at(3.0)), "a command after the lapse renews nothing");
}

fn keeper(store: &str, action: LeaseAction) -> LeaseRequest {
    LeaseRequest {
        store: Some(store.into()),
        ..request(store, MISSION, action)
    }
}

fn caught_up(store: &str, epoch: u64, revision: u64, stores: &[&str]) -> LeaseRequest {
    LeaseRequest {
        leads: Some(Leader {
            store: store.into(),
            epoch,
            caught_up: stores.iter().map(|&store| store.into()).collect(),
            revision,
        }),
        ..keeper(store, LeaseAction::CaughtUp)
    }
}

#[test]
fn only_a_mission_that_has_caught_up_leads_next() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
    let alone = Err(Refusal::NotCaughtUp {
        caught_up: vec!["a".into()],
    });
    assert_eq!(arbiter.request(at(2.0), &keeper("b", TAKE)), alone);
    arbiter.request(at(2.0), &caught_up("a", 1, 1, &["a", "b"])).unwrap();
    assert_eq!(arbiter.request(at(2.0), &keeper("b", TAKE)).unwrap().epoch, 2);
    // From now on the new leader is alone: the old one has missed its writes.
    assert!(matches!(
        arbiter.request(at(4.0), &keeper("a", TAKE)),
        Err(Refusal::NotCaughtUp { .. })
    ));
    assert_eq!(
        arbiter.request(at(4.0), &caught_up("a", 1, 2, &["a"])),
        Err(Refusal::NotLeader),
        "a deposed leader's word counts no more"
    );
    // Not even after a restart of the robot.
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 2, arbiter.leader().cloned());
    assert!(arbiter.request(at(0.0), &keeper("a", TAKE)).is_err());
    arbiter
        .request(at(0.0), &request("me", LeaseRole::Operator, LeaseAction::Forget))
        .unwrap();
    assert!(arbiter.request(at(0.0), &keeper("a", TAKE)).is_ok());
}

#[test]
fn a_report_whose_number_leaps_is_refused_and_the_leader_is_still_heard() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
    let life = 7 << 32;
    for last in [0, life] {
        for leap in [u64::MAX, u64::MAX - 1, 1 << 60] {
            let forged = arbiter.request(at(0.1), &caught_up("a", 1, leap, &["a", "nobody"]));
            assert!(
                matches!(forged, Err(Refusal::Rejected { .. })),
                "after {last}: {forged:?}"
            );
        }
        arbiter
            .request(at(0.1), &caught_up("a", 1, life + u64::from(last > 0), &["a", "b"]))
            .unwrap();
    }
    // The leader after a restart, still under the same epoch, as when an operator holds the lease meanwhile.
    arbiter
        .request(at(0.2), &caught_up("a", 1, 8 << 32, &["a", "b"]))
        .unwrap();
    assert_eq!(arbiter.request(at(2.0), &keeper("b", TAKE)).unwrap().epoch, 2);
}

#[test]
fn a_forged_report_of_one_leadership_does_not_outlive_it() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
    arbiter
        .request(at(0.1), &caught_up("a", 1, 1 << 51, &["a", "nobody"]))
        .unwrap();
    assert_eq!(
        arbiter.request(at(0.2), &caught_up("a", 1, 1, &["a", "b"])),
        Err(Refusal::NotLeader)
    );
    // The leader asks for the lease again, under a new epoch: it leads, and counts as heard.
    let again = arbiter.request(at(0.3), &keeper("a", TAKE)).unwrap();
    arbiter
        .request(at(0.4), &caught_up("a", again.epoch, 1 << 32, &["a", "b"]))
        .unwrap();
    assert!(arbiter.request(at(2.0), &keeper("b", TAKE)).is_ok());
}

#[test]
fn a_leader_s_word_of_an_earlier_life_counts_no_more() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
    let again = arbiter.request(at(0.1), &keeper("a", TAKE)).unwrap();
    assert_eq!((again.epoch, again.holder_changed), (2, false));
    assert_eq!(
        arbiter.request(at(0.2), &caught_up("a", 1, 1, &["a", "b"])),
        Err(Refusal::NotLeader)
    );
    assert!(matches!(
        arbiter.request(at(2.0), &keeper("b", TAKE)),
        Err(Refusal::NotCaughtUp { .. })
    ));
}

#[test]
fn who_keeps_no_goals_and_an_operator_change_nothing_in_who_leads() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
    arbiter
        .request(at(0.1), &request("me", LeaseRole::Operator, TAKE))
        .unwrap();
    arbiter.request(at(2.0), &request("simple", MISSION, TAKE)).unwrap();
    assert_eq!(arbiter.leader().map(|leader| leader.store.as_str()), Some("a"));
    let refused = arbiter.request(at(2.1), &keeper("b", TAKE));
    assert!(matches!(refused, Err(Refusal::Held { leader: Some(leader), .. }) if leader.store == "a"));
}

#[test]
fn a_leader_s_word_that_comes_late_counts_no_more() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
    arbiter.request(at(0.1), &caught_up("a", 1, 2, &["a"])).unwrap();
    assert_eq!(
        arbiter.request(at(0.2), &caught_up("a", 1, 1, &["a", "b"])),
        Err(Refusal::NotLeader)
    );
    assert_eq!(arbiter.leader().unwrap().caught_up, ["a"]);
}

#[test]
fn while_an_operator_commands_a_silent_leader_is_followed_by_one_that_has_caught_up() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter.request(at(0.0), &keeper("a", TAKE)).unwrap();
    arbiter.request(at(0.0), &caught_up("a", 1, 1, &["a", "b"])).unwrap();
    arbiter
        .request(at(0.5), &request("me", LeaseRole::Operator, TAKE))
        .unwrap();
    let leader = |answer: Result<Granted, Refusal>| match answer {
        Err(Refusal::Held { leader, .. }) => leader.unwrap().store,
        other => panic!("{other:?}"),
    };
    for tick in 1..=8_u32 {
        let now = at(0.5 + 0.5 * f64::from(tick));
        assert!(arbiter.renew(now, &beat("me", 2, u64::from(tick))));
        let told = leader(arbiter.request(now, &keeper("b", TAKE)));
        assert_eq!(told, if tick < 4 { "a" } else { "b" }, "{tick}");
        assert!(arbiter.admits(now, 2), "the operator goes on");
    }
    assert_eq!(
        leader(arbiter.request(at(4.6), &keeper("a", TAKE))),
        "b",
        "the old leader hears of it"
    );
}

#[test]
fn an_operator_outranks_a_mission_but_not_the_other_way_round() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter.request(at(0.0), &request("a", MISSION, TAKE)).unwrap();
    arbiter
        .request(at(0.1), &request("me", LeaseRole::Operator, TAKE))
        .unwrap();
    assert!(matches!(
        arbiter.request(at(0.2), &request("a", MISSION, TAKE)),
        Err(Refusal::Held { .. })
    ));
    arbiter
        .request(at(0.3), &request("me", LeaseRole::Operator, LeaseAction::Release))
        .unwrap();
    assert_eq!(
        arbiter.request(at(0.4), &request("a", MISSION, TAKE)),
        Ok(Granted {
            epoch: 3,
            holder_changed: true,
            round_trip: None,
        })
    );
}

fn echoed(counter: u64, echo: f64) -> Heartbeat {
    Heartbeat {
        echo: Some(at(echo)),
        ..beat("a", 1, counter)
    }
}

#[test]
fn a_grant_over_a_slow_link_lives_until_its_first_heartbeat_and_from_then_on_as_on_any_link() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    let slow = LeaseRequest {
        echo: Some(at(6.0)),
        ..request("a", MISSION, TAKE)
    };
    arbiter.request(at(10.0), &slow).unwrap();
    assert!(arbiter.is_live(at(14.9)) && !arbiter.is_live(at(15.1)));
    assert!(
        arbiter.request(at(14.9), &request("b", MISSION, TAKE)).is_err(),
        "nobody else meanwhile"
    );
    assert!(arbiter.renew(at(14.2), &echoed(1, 10.2)));
    assert_eq!(arbiter.round_trip(), Some(Duration::from_secs(4)));
    assert!(
        arbiter.is_live(at(15.1)) && !arbiter.is_live(at(15.3)),
        "heartbeats come as often as they are sent"
    );
}

#[test]
fn no_echo_holds_a_lease_for_longer_than_the_longest_round_trip() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    let replayed = LeaseRequest {
        echo: Some(Stamp::ZERO),
        ..request("a", MISSION, TAKE)
    };
    arbiter.request(at(1e6), &replayed).unwrap();
    assert!(!arbiter.is_live(at(1e6 + 11.1)));
    assert!(
        arbiter.renew(at(1e6 + 1.0), &echoed(1, 2e6)),
        "an echo of the future is no round trip"
    );
    assert_eq!(arbiter.round_trip(), Some(Duration::ZERO));
}

#[test]
fn the_longest_round_trip_of_late_is_forgotten_slowly() {
    let mut arbiter = LeaseArbiter::new(Duration::from_secs(1), 0, None);
    arbiter.request(at(0.0), &request("a", MISSION, TAKE)).unwrap();
    let round_trip = |arbiter: &LeaseArbiter| arbiter.round_trip().unwrap().as_secs_f64();
    arbiter.renew(at(0.1), &echoed(1, -0.0));
    for tick in 2..=100_u32 {
        let now = 0.1 * f64::from(tick);
        let late = if tick == 20 { 0.8 } else { 0.05 };
        arbiter.renew(at(now), &echoed(tick.into(), now - late));
        let told = round_trip(&arbiter);
        assert!(tick != 20 || (told - 0.8).abs() < 1e-6);
        assert!(tick != 50 || (0.35..0.5).contains(&told), "{told}");
    }
    assert!(round_trip(&arbiter) < 0.2);
}
