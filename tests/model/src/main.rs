//! Checks the contract's model and prints the results: `cargo run --release -p zenav-model -- --bounds large`.

#![expect(clippy::print_stdout, reason = "a command that prints its findings")]

use std::process::ExitCode;
use std::slice;

use clap::Parser;
use zenav_model::check::{ContractModel, Outcome, Size, check};
use zenav_model::goals::Goals;
use zenav_model::handover::Handover;
use zenav_model::lease::Lease;
use zenav_model::plan::PlanValidity;
use zenav_model::stop::Stop;

/// Checks the contract's model: all rules, then without each of them, and without both of two that cover for one another
#[derive(Debug, Parser)]
struct Arguments {
    /// Size of the bounds
    #[arg(long, value_enum, default_value = "small")]
    bounds: Size,
    /// Only this part
    #[arg(long, value_parser = ["lease", "plan", "stop", "goals", "handover"])]
    part: Option<String>,
    /// Only with all rules, not without each of them
    #[arg(long)]
    rules: bool,
}

/// Checks and prints a part; returns whether the results are as expected.
type Run = fn(&Arguments) -> bool;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let parts: [(&str, Run); 5] = [
        (Lease::NAME, part::<Lease>),
        (PlanValidity::NAME, part::<PlanValidity>),
        (Stop::NAME, part::<Stop>),
        (Goals::NAME, part::<Goals>),
        (Handover::NAME, part::<Handover>),
    ];
    let wanted = |name: &str| arguments.part.as_deref().is_none_or(|part| part == name);
    let mut holds = true;
    for (_, run) in parts.iter().filter(|(name, _)| wanted(name)) {
        holds &= run(&arguments);
    }
    if holds { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Checks a part and prints its tables for `docs/model.md`; returns whether it holds, and fails without each rule.
fn part<P: ContractModel>(arguments: &Arguments) -> bool {
    println!("## {}\n", P::NAME);
    let mut holds = true;
    let mut claims = Vec::new();
    let tested = P::scenarios(Size::Small).len();
    println!(
        "| bounds | states | transitions | actions deep | in every test run | seconds | |\n|---|---|---|---|---|---|---|"
    );
    for (which, bounds) in P::scenarios(arguments.bounds).into_iter().enumerate() {
        let outcome = check(|| P::system(bounds, &[]));
        holds &= outcome.holds();
        print(&P::in_words(&bounds), &outcome, which < tested);
        claims.push(outcome);
    }
    println!("\n| claim | |\n|---|---|");
    for claim in claims.first().map(|outcome| outcome.claims.clone()).unwrap_or_default() {
        let is_broken = |outcome: &Outcome| outcome.violation.as_ref().is_some_and(|(broken, _)| *broken == claim);
        let verdict = if claims.iter().any(is_broken) {
            "BROKEN"
        } else if claims.iter().all(|outcome| outcome.missing.contains(&claim)) {
            holds = false;
            "NOT SEEN"
        } else {
            "holds"
        };
        println!("| {claim} | {verdict} |");
    }
    if arguments.rules {
        return holds;
    }
    println!("\n| without the rule | does not hold | shortest trace |\n|---|---|---|");
    for (rule, says) in P::RULES {
        let outcome = check(|| P::system(P::breaks_in(*rule), slice::from_ref(rule)));
        let (claim, trace) = outcome.violation.unwrap_or(("nothing is broken", Vec::new()));
        holds &= !trace.is_empty();
        println!("| {says} | {claim} | {} |", trace.join(" → "));
    }
    for (rules, says, bounds) in P::PAIRS {
        let holds_without = |rule| check(|| P::system(*bounds, slice::from_ref(rule))).holds();
        holds &= rules.iter().all(holds_without);
        let outcome = check(|| P::system(*bounds, rules));
        let (claim, trace) = outcome.violation.unwrap_or(("nothing is broken", Vec::new()));
        holds &= !trace.is_empty();
        println!("| neither: {says} | {claim} | {} |", trace.join(" → "));
    }
    println!();
    holds
}

fn print(bounds: &str, outcome: &Outcome, is_tested: bool) {
    let secs = outcome.took.as_secs_f64();
    let verdict = match &outcome.violation {
        Some((claim, _)) => *claim,
        None if outcome.is_complete => "holds",
        None => "given up: too many states",
    };
    println!(
        "| {bounds} | {} | {} | {} | {} | {secs:.1} | {verdict} |",
        outcome.states,
        outcome.transitions,
        outcome.depth,
        if is_tested { "yes" } else { "no" }
    );
    if let Some((_, trace)) = &outcome.violation {
        trace.iter().for_each(|action| println!("  {action}"));
    }
}
