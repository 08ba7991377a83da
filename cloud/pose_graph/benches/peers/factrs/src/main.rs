//! Peer of the pose graph: factrs's optimisers on the same graph, from the same start.
//!
//! ```sh
//! cargo build --release
//! target/release/factrs-peer gauss_newton|levenberg_marquardt RUNS < GRAPH.g2o
//! ```
//!
//! Prints the median of RUNS processor times in ms (of all threads; after one run to warm up, if there are several), factrs's chi squared,
//! and `x y yaw` of each vertex. Reading and copying are not timed; setting up the optimiser is. All vertices must be given.
//!
//! Both methods have factrs's default parameters, solver (faer's sparse Cholesky) and features, which leave it one thread. Its own reader
//! reads the file, but would hold the second vertex: the first is held here, by the prior of GTSAM's peer.
//!
//! Its error is meant to be GTSAM's, the logarithm of the pose that is left over. In factrs 0.3.0 it is that for an angle above zero; for one
//! below it is the angle and the position as they are, because the test for an angle too small to divide by has no absolute value.

use std::error::Error;
use std::time::Duration;

use factrs::containers::FactorBuilder;
use factrs::core::{GaussNewton, GaussianNoise, Graph, LevenMarquardt, PriorResidual, SE2, Values};
use factrs::optimizers::OptError;
use factrs::traits::Optimizer;
use factrs::utils::load_g20;
use rustix::time::{ClockId, clock_gettime};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [method, runs] = &arguments[..] else {
        return Err("expected a method and the number of runs".into());
    };
    let solved = match method.as_str() {
        "gauss_newton" => solved::<GaussNewton>,
        "levenberg_marquardt" => solved::<LevenMarquardt>,
        _ => return Err(format!("expected gauss_newton or levenberg_marquardt, found `{method}`").into()),
    };
    let runs: usize = runs.parse()?;
    let warm_up = usize::from(runs > 1);
    let (graph, start) = read()?;
    let mut times = Vec::new();
    let mut poses = start.clone();
    for _ in 0..warm_up + runs {
        let (ms, end) = solved(graph.clone(), start.clone())?;
        times.push(ms);
        poses = end;
    }
    // Its cost is half of chi squared.
    println!("{} {}", median(&mut times[warm_up..]), 2.0 * graph.error(&poses));
    for pose in poses.filter::<SE2>() {
        println!("{} {} {}", pose.x(), pose.y(), pose.theta());
    }
    Ok(())
}

/// The graph and its start as `load_g20` has them, from a file, and without the lines that it would print as unknown.
fn read() -> Result<(Graph, Values), Box<dyn Error>> {
    let text = std::io::read_to_string(std::io::stdin())?;
    let lines: Vec<&str> = text.lines().filter(|line| is_known(line)).collect();
    let file = std::env::temp_dir().join(format!("factrs-peer-{}.g2o", std::process::id()));
    std::fs::write(&file, lines.join("\n"))?;
    let (graph, start) = load_g20(&file.to_string_lossy());
    std::fs::remove_file(&file)?;
    Ok((held(graph, &start)?, start))
}

fn is_known(line: &str) -> bool {
    line.starts_with("VERTEX_SE2 ") || line.starts_with("EDGE_SE2 ")
}

/// The same edges, and a prior on the first vertex instead of the second.
fn held(graph: Graph, start: &Values) -> Result<Graph, Box<dyn Error>> {
    let mut held = Graph::with_capacity(graph.len());
    for factor in graph.into_iter().filter(|factor| factor.keys().len() == 2) {
        held.add_factor(factor);
    }
    let (first, _) = start.iter().next().ok_or("no vertex")?;
    let pose: &SE2 = start
        .get_unchecked(*first)
        .ok_or("the first vertex is not in the plane")?;
    // The angle comes first.
    let noise = GaussianNoise::<3>::from_diag_covs(1e-8, 1e-6, 1e-6);
    let prior = FactorBuilder::new1_unchecked(PriorResidual::new(pose.clone()), *first);
    held.add_factor(prior.noise(noise).build());
    Ok(held)
}

/// Processor time in ms, and the poses at which the method ends.
fn solved<O: Optimizer>(graph: Graph, start: Values) -> Result<(f64, Values), Box<dyn Error>> {
    let begin = process_time()?;
    let end = O::new_default(graph).optimize(start);
    let took = process_time()?.saturating_sub(begin);
    Ok((1e3 * took.as_secs_f64(), end.map_err(why)?))
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn process_time() -> Result<Duration, Box<dyn Error>> {
    Ok(Duration::try_from(clock_gettime(ClockId::ProcessCPUTime))?)
}

fn why(error: OptError) -> &'static str {
    match error {
        OptError::MaxIterations(_) => "no convergence in the iterations allowed",
        OptError::InvalidSystem => "invalid system",
        OptError::FailedToStep => "no step lowers the cost",
    }
}
