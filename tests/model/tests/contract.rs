//! The contract holds in every state within the bounds, and not without any one of its rules.

#![expect(
    clippy::print_stdout,
    reason = "states and traces, for whoever runs it with --nocapture"
)]

use std::collections::BTreeSet;
use std::slice;

use zenav_model::check::{ContractModel, Size, check};
use zenav_model::goals::Goals;
use zenav_model::handover::Handover;
use zenav_model::lease::Lease;
use zenav_model::plan::PlanValidity;
use zenav_model::stop::Stop;

fn holds<P: ContractModel>() {
    let mut missing: Option<BTreeSet<&str>> = None;
    for bounds in P::scenarios(Size::Small) {
        let outcome = check(|| P::system(bounds, &[]));
        let bounds = P::in_words(&bounds);
        println!(
            "{}, {bounds}: {} states, {} actions deep, {:?}",
            P::NAME,
            outcome.states,
            outcome.depth,
            outcome.took
        );
        assert_eq!(outcome.violation, None, "{bounds}");
        assert!(outcome.is_complete, "{bounds}: too many states");
        let unseen: BTreeSet<&str> = outcome.missing.into_iter().collect();
        missing = Some(missing.map_or(unseen.clone(), |before| &before & &unseen));
    }
    assert_eq!(
        missing,
        Some(BTreeSet::new()),
        "what must happen for the claims to say anything"
    );
}

fn breaks_without_each_rule<P: ContractModel>() {
    let mut harmless = Vec::new();
    for (rule, says) in P::RULES {
        let outcome = check(|| P::system(P::breaks_in(*rule), slice::from_ref(rule)));
        let Some((claim, trace)) = outcome.violation else {
            harmless.push((rule, outcome.states));
            continue;
        };
        println!("{} without {rule:?} ({says}), broken: {claim}", P::NAME);
        trace.iter().for_each(|action| println!("  {action}"));
    }
    assert!(harmless.is_empty(), "nothing is broken without {harmless:?}");
}

fn breaks_without_both_of_a_pair<P: ContractModel>() {
    for (rules, says, bounds) in P::PAIRS {
        for rule in rules {
            let outcome = check(|| P::system(*bounds, slice::from_ref(rule)));
            assert!(outcome.holds(), "without {rule:?} alone: {:?}", outcome.violation);
        }
        let outcome = check(|| P::system(*bounds, rules));
        let (claim, trace) = outcome
            .violation
            .unwrap_or_else(|| panic!("nothing is broken without {rules:?}"));
        println!("{} without {rules:?} ({says}), broken: {claim}", P::NAME);
        trace.iter().for_each(|action| println!("  {action}"));
    }
}

#[test]
fn only_the_holder_of_the_lease_commands() {
    holds::<Lease>();
}

#[test]
fn without_a_rule_of_the_lease_somebody_else_commands() {
    breaks_without_each_rule::<Lease>();
}

#[test]
fn a_plan_moves_the_robot_while_it_is_valid_and_no_longer() {
    holds::<PlanValidity>();
}

#[test]
fn without_a_rule_of_plans_one_moves_the_robot_that_must_not() {
    breaks_without_each_rule::<PlanValidity>();
}

#[test]
fn a_stop_holds_until_a_resume_of_the_newest_stop() {
    holds::<Stop>();
}

#[test]
fn without_a_rule_of_stops_one_is_lifted_that_must_hold() {
    breaks_without_each_rule::<Stop>();
}

#[test]
fn a_goal_survives_crashes_and_ends_once() {
    holds::<Goals>();
}

#[test]
fn without_a_rule_of_goals_one_is_lost_or_ends_twice() {
    breaks_without_each_rule::<Goals>();
}

#[test]
fn who_takes_over_has_everything_that_was_acknowledged() {
    holds::<Handover>();
}

#[test]
fn without_a_rule_of_handover_an_acknowledged_goal_is_lost() {
    breaks_without_each_rule::<Handover>();
}

#[test]
fn of_two_rules_of_handover_that_cover_for_one_another_one_is_enough_and_none_is_not() {
    breaks_without_both_of_a_pair::<Handover>();
}
