//! Evidence. Which closures do the others confirm, and which fit by chance only?
//!
//! What a closure measures is foreseen by odometry and the closures accepted so far, with a covariance along the graph. It is accepted if it
//! lies within chi squared of that, and if no false closure may be expected to fit as well ([`Chance`]): where nodes are well known to each
//! other one closure suffices, and where the graph could be anywhere several have to agree, each confirmed by the rest. One that sees much
//! farther than any accepted one needs more evidence. An accepted closure is weighed the same way, by what is foreseen without it.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation2, Vector3};
use zenav_protocol::geometry::{Pose2, wrap_angle};

use crate::chance::Chance;
use crate::descent::{Problem, chi_squared, descend, edge_chi_squared};
use crate::graph::{Edge, EdgeKind, PoseGraph};
use crate::linear::{BlockSystem, Half, Halves};
use crate::settings::{DescentSettings, RobustSettings};
use crate::start::pattern;

/// A closure is accepted if at most this many false ones may be expected to fit as well, in the whole graph.
const ACCEPTED: f64 = 0.05;
/// The same for those that are accepted at once: the others wait, since what is accepted makes clearer what is foreseen.
const ACCEPTED_AT_ONCE: f64 = 0.005;
/// What waits is accepted with the best of it, up to this factor of its number.
const TOGETHER: f64 = 3.0;
/// An accepted closure that is confirmed around a short cycle is weighed nevertheless if its chi squared is larger than this.
const CONSPICUOUS: f64 = 6.0;
/// A closure that sees farther than any accepted one by this factor needs more evidence.
const FAR_SEEING: f64 = 2.0;
/// Closures farther than this factor beyond chi squared are not asked again before the others are settled.
const FAR: f64 = 4.0;
/// A closure of which the others foresee less than this share is foreseen by nothing.
const LEAST_SHARE: f64 = 1e-9;
/// Added to information matrices before they are inverted, as a share of the largest entry.
const LEAST_INFORMATION: f64 = 1e-9;
/// Most closures that are accepted together since they agree: others follow once these are accepted.
const MAX_GROUP: usize = 4;
/// Most rounds of acceptance.
const MAX_ROUNDS: usize = 40;
/// A rejected group of at least this many contests the accepted closures.
const CONTESTING: usize = 4;
/// Most groups of rejected closures that are tried against the accepted ones.
const MAX_TRIALS: usize = 16;

/// A closure, its information and the root of that in the frame of its first node.
struct Closure {
    index: usize,
    information: Matrix3<f64>,
    root: Matrix3<f64>,
}

impl Closure {
    fn new(index: usize, edge: &Edge) -> Self {
        let turn = Rotation2::new(edge.measurement.yaw).to_homogeneous();
        let information = turn * edge.information * turn.transpose();
        let eigen = ((information + information.transpose()) * 0.5).symmetric_eigen();
        let roots = Matrix3::from_diagonal(&eigen.eigenvalues.map(|value| value.max(0.0).sqrt()));
        Self {
            index,
            information,
            root: eigen.eigenvectors * roots * eigen.eigenvectors.transpose(),
        }
    }

    /// `covariance`: of the difference between poses and measurement, as the others determine it.
    fn beside(&self, gap: &Vector3<f64>, covariance: &Matrix3<f64>) -> Option<Fit> {
        let inverse = (Matrix3::identity() + self.root * covariance * self.root).try_inverse()?;
        let error = self.root * gap;
        Some(Fit {
            chi_squared: error.dot(&(inverse * error)),
            information: self.root * inverse * self.root,
        })
    }

    /// The same for an accepted closure, from the poses and the covariance that it has contributed to itself. `None` if without it nothing
    /// would be foreseen.
    fn without(&self, gap: &Vector3<f64>, covariance: &Matrix3<f64>) -> Option<Fit> {
        let rest = Matrix3::identity() - self.root * covariance * self.root;
        if rest.symmetric_eigenvalues().min() < LEAST_SHARE {
            return None;
        }
        let error = self.root * gap;
        Some(Fit {
            chi_squared: error.dot(&(rest.try_inverse()? * error)),
            information: self.root * rest * self.root,
        })
    }

    /// Of the measurement alone.
    fn covariance(&self) -> Option<Matrix3<f64>> {
        let least = Matrix3::identity() * (LEAST_INFORMATION * self.information.amax());
        (self.information + least).try_inverse()
    }
}

/// How a closure agrees with what is foreseen.
struct Fit {
    chi_squared: f64,
    /// Of the difference: the inverse of what is foreseen and what was measured together.
    information: Matrix3<f64>,
}

/// What the closures that are decided tell about the others.
struct Background {
    chance: Chance,
    /// Number of accepted closures, and how far they see at most, m.
    accepted: u32,
    reach: f64,
}

/// A rejected closure that may be true.
struct Plausible {
    /// Its place among the closures.
    at: usize,
    gap: Vector3<f64>,
    fit: Fit,
}

/// The plausible closures that are searched for ones that agree with each other, best fit first.
struct Best<'p> {
    all: Vec<&'p Plausible>,
    /// Of their gaps, as the accepted edges determine them: three rows and three columns for each.
    covariance: DMatrix<f64>,
}

impl Best<'_> {
    /// Of two gaps.
    fn covariance(&self, row: usize, column: usize) -> Matrix3<f64> {
        self.covariance.fixed_view::<3, 3>(3 * row, 3 * column).into_owned()
    }
}

/// The closures of a graph, and which of them are accepted.
pub(crate) struct Weighing<'g> {
    graph: &'g PoseGraph,
    settings: &'g RobustSettings,
    closures: Vec<Closure>,
    /// Pairs that agree around a short cycle; one that agrees with odometry alone is a pair with itself.
    pairs: &'g [[usize; 2]],
    /// Closures that were accepted since the others confirm them.
    is_sure: Vec<bool>,
    /// Closures that were dropped since nothing confirms them: they come back in company only.
    is_lone: Vec<bool>,
    /// Places of the closures that may still be accepted.
    open: Vec<usize>,
    pub(crate) weights: Vec<f64>,
    pub(crate) poses: Vec<Pose2>,
}

impl<'g> Weighing<'g> {
    /// `weights`: 1 or 0.
    pub(crate) fn new(
        graph: &'g PoseGraph,
        settings: &'g RobustSettings,
        pairs: &'g [[usize; 2]],
        weights: Vec<f64>,
        poses: Vec<Pose2>,
    ) -> Self {
        let edges = graph.edges().iter().enumerate();
        let closures = edges.filter(|(_, edge)| edge.kind == EdgeKind::Closure);
        let closures: Vec<Closure> = closures.map(|(index, edge)| Closure::new(index, edge)).collect();
        Self {
            graph,
            settings,
            pairs,
            is_sure: vec![false; weights.len()],
            is_lone: vec![false; weights.len()],
            open: (0..closures.len()).collect(),
            closures,
            weights,
            poses,
        }
    }

    /// Tries rejected groups that agree around short cycles against the accepted closures.
    pub(crate) fn try_rejected(&mut self, descent: &DescentSettings) {
        for group in self.groups().into_iter().take(MAX_TRIALS) {
            self.try_against_the_others(&group, descent);
        }
    }

    /// Whether closures that agree around short cycles are rejected in groups: then these contradict the accepted ones.
    pub(crate) fn is_contested(&self) -> bool {
        self.groups().first().is_some_and(|group| group.len() >= CONTESTING)
    }

    /// Accepts and drops closures until no evidence is left that is not used.
    pub(crate) fn settle(&mut self, descent: &DescentSettings) {
        let mut is_full = true;
        for _ in 0..MAX_ROUNDS {
            self.fit(descent, &[]);
            if is_full {
                self.open = (0..self.closures.len()).collect();
            }
            let has_changed = self.weigh();
            if !has_changed && is_full {
                return;
            }
            is_full = !has_changed;
        }
        self.fit(descent, &[]);
    }

    /// Moves the poses to the minimum, and drops closures that do not fit there, except for some.
    fn fit(&mut self, descent: &DescentSettings, except: &[usize]) {
        loop {
            self.poses = descend(self.graph, &self.poses, &self.weights, descent).poses;
            if !drop_worst(self.graph, &mut self.weights, &self.poses, self.settings, except) {
                return;
            }
            // They may have confirmed others.
            self.is_sure.fill(false);
        }
    }

    /// Drops accepted closures that nothing confirms; if there are none, accepts rejected ones that the others confirm. Returns whether
    /// there were any.
    fn weigh(&mut self) -> bool {
        let Some(pattern) = pattern(self.graph, &self.weights) else {
            return false;
        };
        let Some(system) = Problem::new(self.graph, &self.weights, &pattern).factorised(&self.poses) else {
            return false;
        };
        let Some(mut halves) = system.halves() else {
            return false;
        };
        let plausible = self.plausible(&mut halves);
        let background = self.background(&plausible);
        let lone = self.lone(&mut halves, &background);
        for index in &lone {
            self.weights[*index] = 0.0;
            self.is_lone[*index] = true;
        }
        if !lone.is_empty() {
            // They may have confirmed others.
            self.is_sure.fill(false);
            return true;
        }
        let mut accepted = self.confirmed(&plausible, &background);
        for index in &accepted {
            self.is_sure[*index] = true;
        }
        if accepted.is_empty() {
            accepted = self.agreeing(&self.best(&plausible, &mut halves), &background);
        }
        for index in &accepted {
            self.weights[*index] = 1.0;
        }
        !accepted.is_empty()
    }

    fn gap(&self, closure: &Closure) -> Vector3<f64> {
        let edge = &self.graph.edges()[closure.index];
        let seen = self.poses[edge.from].inverse() * self.poses[edge.to];
        let Pose2 { x, y, yaw } = edge.measurement;
        Vector3::new(seen.x - x, seen.y - y, wrap_angle(seen.yaw - yaw))
    }

    /// Half of the covariance of a closure's gap as the accepted edges determine it.
    fn half(&self, closure: &Closure, halves: &mut Halves<'_, 3>) -> Half<3> {
        let edge = &self.graph.edges()[closure.index];
        let from = self.poses[edge.from];
        let seen = from.inverse() * self.poses[edge.to];
        let (sin, cos) = from.yaw.sin_cos();
        let by_from = Matrix3::new(-cos, -sin, seen.y, sin, -cos, -seen.x, 0.0, 0.0, -1.0);
        let by_to = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
        halves.of(&[(edge.from, by_from.transpose()), (edge.to, by_to.transpose())])
    }

    /// The rejected closures that lie within chi squared of what is foreseen, among the open ones; those far off are no longer open.
    fn plausible(&mut self, halves: &mut Halves<'_, 3>) -> Vec<Plausible> {
        let (mut plausible, mut open) = (Vec::new(), Vec::new());
        for at in &self.open {
            let closure = &self.closures[*at];
            if self.weights[closure.index] > 0.0 {
                continue;
            }
            let (half, gap) = (self.half(closure, halves), self.gap(closure));
            let Some(fit) = closure.beside(&gap, &half.covariance(&half)) else {
                continue;
            };
            if fit.chi_squared <= FAR * self.settings.max_chi_squared {
                open.push(*at);
            }
            if fit.chi_squared <= self.settings.max_chi_squared {
                let at = *at;
                plausible.push(Plausible { at, gap, fit });
            }
        }
        self.open = open;
        plausible
    }

    /// From the closures that are rejected and not plausible, and from those that are accepted.
    fn background(&self, plausible: &[Plausible]) -> Background {
        let mut is_false: Vec<bool> = self.weights.iter().map(|weight| *weight == 0.0).collect();
        for one in plausible {
            is_false[self.closures[one.at].index] = false;
        }
        let (mut misses, mut accepted, mut reach) = (Vec::new(), 0, 0.0_f64);
        for closure in &self.closures {
            if is_false[closure.index] {
                misses.push(self.gap(closure).xy().norm());
            } else if self.weights[closure.index] > 0.0 {
                accepted += 1;
                reach = reach.max(self.reach(closure));
            }
        }
        Background {
            chance: Chance::of(misses),
            accepted,
            reach,
        }
    }

    /// How far a closure sees, m.
    fn reach(&self, closure: &Closure) -> f64 {
        let Pose2 { x, y, .. } = self.graph.edges()[closure.index].measurement;
        x.hypot(y)
    }

    /// The expected number of false closures that fit as well; more for one that sees much farther than any accepted one, by how seldom a
    /// true one may do so.
    fn expected(&self, closure: &Closure, fit: &Fit, background: &Background) -> f64 {
        let expected = background.chance.expected(fit.chi_squared, &fit.information);
        let is_far_seeing = self.reach(closure) > FAR_SEEING * background.reach;
        let seldom = if is_far_seeing { background.accepted } else { 0 };
        expected * (f64::from(seldom) * ACCEPTED).max(1.0)
    }

    /// The accepted closures that nothing confirms.
    fn lone(&self, halves: &mut Halves<'_, 3>, background: &Background) -> Vec<usize> {
        let mut is_sure = self.is_sure.clone();
        for [a, b] in self.pairs {
            if self.weights[*a] > 0.0 && self.weights[*b] > 0.0 {
                (is_sure[*a], is_sure[*b]) = (true, true);
            }
        }
        let edges = self.graph.edges();
        let is_asked = |index: usize| !is_sure[index] || edge_chi_squared(&edges[index], &self.poses) > CONSPICUOUS;
        self.unconfirmed(halves, background, ACCEPTED, is_asked)
    }

    /// The accepted closures, of those asked for, that more than this number of false ones may be expected to fit as well as.
    fn unconfirmed(
        &self,
        halves: &mut Halves<'_, 3>,
        background: &Background,
        most: f64,
        is_asked: impl Fn(usize) -> bool,
    ) -> Vec<usize> {
        if !background.chance.is_any() {
            return Vec::new();
        }
        let mut unconfirmed = Vec::new();
        for closure in &self.closures {
            if self.weights[closure.index] == 0.0 || !is_asked(closure.index) {
                continue;
            }
            let half = self.half(closure, halves);
            let fit = closure.without(&self.gap(closure), &half.covariance(&half));
            if fit.is_none_or(|fit| self.expected(closure, &fit, background) > most) {
                unconfirmed.push(closure.index);
            }
        }
        unconfirmed
    }

    /// The rejected closures that the accepted edges confirm; only the best of them as long as these may change what is foreseen.
    fn confirmed(&self, plausible: &[Plausible], background: &Background) -> Vec<usize> {
        let weighed = plausible.iter().map(|one| {
            let closure = &self.closures[one.at];
            (self.expected(closure, &one.fit, background), closure.index)
        });
        let mut found: Vec<(f64, usize)> = weighed
            .filter(|(expected, index)| *expected <= ACCEPTED && !self.is_lone[*index])
            .collect();
        let least = found
            .iter()
            .map(|(expected, _)| *expected)
            .fold(f64::INFINITY, f64::min);
        found.retain(|(expected, _)| *expected <= ACCEPTED_AT_ONCE.max(TOGETHER * least));
        found.into_iter().map(|(_, index)| index).collect()
    }

    /// The plausible closures that fit best, no more than are to be reconsidered.
    fn best<'p>(&self, plausible: &'p [Plausible], halves: &mut Halves<'_, 3>) -> Best<'p> {
        let mut all: Vec<&Plausible> = plausible.iter().collect();
        all.sort_by(|a, b| a.fit.chi_squared.total_cmp(&b.fit.chi_squared));
        all.truncate(self.settings.reconsidered as usize);
        let half: Vec<Half<3>> = all
            .iter()
            .map(|one| self.half(&self.closures[one.at], halves))
            .collect();
        let mut covariance = DMatrix::zeros(3 * all.len(), 3 * all.len());
        for (row, a) in half.iter().enumerate() {
            for (column, b) in half.iter().enumerate().skip(row) {
                let block = a.covariance(b);
                covariance.fixed_view_mut::<3, 3>(3 * row, 3 * column).copy_from(&block);
                covariance
                    .fixed_view_mut::<3, 3>(3 * column, 3 * row)
                    .copy_from(&block.transpose());
            }
        }
        Best { all, covariance }
    }

    /// The rejected closures, two or more, that agree best with each other: each is confirmed by the rest, and together they are no chance.
    fn agreeing(&self, among: &Best<'_>, background: &Background) -> Vec<usize> {
        let mut best = (ACCEPTED, Vec::new());
        for (first, one) in among.all.iter().enumerate() {
            let mut all = self.expected(&self.closures[one.at], &one.fit, background);
            let mut group = vec![first];
            while group.len() < MAX_GROUP {
                // What repeats a measurement confirms nothing.
                let edge = |at: &usize| &self.graph.edges()[self.closures[among.all[*at].at].index];
                let others = (0..among.all.len()).filter(|at| group.iter().all(|other| edge(other) != edge(at)));
                let given = others.filter_map(|at| Some((self.given(among, at, &group, background)?, at)));
                let next = given.min_by(|a, b| a.0.total_cmp(&b.0));
                let Some((expected, next)) = next.filter(|(expected, _)| *expected <= ACCEPTED) else {
                    break;
                };
                all *= expected;
                group.push(next);
            }
            let is_confirmed = |at: &usize| {
                let rest: Vec<usize> = group.iter().copied().filter(|other| other != at).collect();
                let given = self.given(among, *at, &rest, background);
                given.is_some_and(|expected| expected <= ACCEPTED)
            };
            if group.len() > 1 && all < best.0 && group.iter().all(is_confirmed) {
                best = (all, group);
            }
        }
        let (_, group) = best;
        group
            .into_iter()
            .map(|at| self.closures[among.all[at].at].index)
            .collect()
    }

    /// The expected number of false closures that fit as well as one, if a group is accepted. `None` if it does not fit then.
    fn given(&self, among: &Best<'_>, one: usize, group: &[usize], background: &Background) -> Option<f64> {
        let size = 3 * group.len();
        let (mut joint, mut gaps) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let mut mixed = DMatrix::zeros(size, 3);
        for (row, a) in group.iter().enumerate() {
            gaps.fixed_rows_mut::<3>(3 * row).copy_from(&among.all[*a].gap);
            mixed
                .fixed_view_mut::<3, 3>(3 * row, 0)
                .copy_from(&among.covariance(*a, one));
            for (column, b) in group.iter().enumerate() {
                let mut block = among.covariance(*a, *b);
                if row == column {
                    block += self.closures[among.all[*a].at].covariance()?;
                }
                joint.fixed_view_mut::<3, 3>(3 * row, 3 * column).copy_from(&block);
            }
        }
        let solved = joint.cholesky()?.solve(&mixed);
        let by_group = solved.transpose() * gaps;
        let known = mixed.transpose() * solved;
        let closure = &self.closures[among.all[one].at];
        let gap = among.all[one].gap - by_group.fixed_rows::<3>(0);
        let covariance = among.covariance(one, one) - known.fixed_view::<3, 3>(0, 0);
        let fit = closure.beside(&gap, &covariance)?;
        (fit.chi_squared <= self.settings.max_chi_squared).then(|| self.expected(closure, &fit, background))
    }

    /// Rejected closures that agree with each other around short cycles, by group, the largest first.
    fn groups(&self) -> Vec<Vec<usize>> {
        let mut group_of: Vec<usize> = (0..self.weights.len()).collect();
        let is_open = |pair: &&[usize; 2]| pair[0] != pair[1] && pair.iter().all(|index| self.weights[*index] == 0.0);
        for [a, b] in self.pairs.iter().filter(is_open) {
            let (a, b) = (group_of[*a], group_of[*b]);
            if a == b {
                continue;
            }
            for group in &mut group_of {
                if *group == a.max(b) {
                    *group = a.min(b);
                }
            }
        }
        let mut groups = vec![Vec::new(); self.weights.len()];
        for (index, group) in group_of.into_iter().enumerate() {
            groups[group].push(index);
        }
        groups.retain(|group| group.len() > 1);
        groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
        groups
    }

    /// Accepts a group in place of the closures that it contradicts, if the truncated cost is lower then, also once all others are settled.
    fn try_against_the_others(&mut self, group: &[usize], descent: &DescentSettings) {
        let cost = self.truncated_cost();
        let before = (self.weights.clone(), self.poses.clone());
        let flags = (self.is_sure.clone(), self.is_lone.clone());
        for index in group {
            self.weights[*index] = 1.0;
        }
        self.fit(descent, group);
        if self.truncated_cost() < cost {
            self.settle(descent);
            if self.truncated_cost() < cost {
                return;
            }
        }
        (self.weights, self.poses) = before;
        (self.is_sure, self.is_lone) = flags;
    }

    /// A true closure costs its chi squared, a false one the largest that a true one may have.
    pub(crate) fn truncated_cost(&self) -> f64 {
        let rejected = self.weights.iter().filter(|weight| **weight == 0.0).count();
        chi_squared(self.graph, &self.poses, &self.weights) + self.settings.max_chi_squared * rejected as f64
    }

    /// The rejected closures that are plausible, and the accepted ones that were not accepted at once. Ascending.
    pub(crate) fn doubtful(&mut self) -> Vec<usize> {
        let Some(pattern) = pattern(self.graph, &self.weights) else {
            return Vec::new();
        };
        let system = Problem::new(self.graph, &self.weights, &pattern).factorised(&self.poses);
        let Some(mut halves) = system.as_ref().and_then(BlockSystem::halves) else {
            return Vec::new();
        };
        let plausible = self.plausible(&mut halves);
        let background = self.background(&plausible);
        let mut doubtful = self.unconfirmed(&mut halves, &background, ACCEPTED_AT_ONCE, |_| true);
        doubtful.extend(plausible.iter().map(|one| self.closures[one.at].index));
        doubtful.sort_unstable();
        doubtful
    }
}

/// Switches off the accepted closures that fit worst, since they bend the others; returns whether there were any that do not fit.
pub(crate) fn drop_worst(
    graph: &PoseGraph,
    weights: &mut [f64],
    poses: &[Pose2],
    settings: &RobustSettings,
    except: &[usize],
) -> bool {
    let misfit = |(index, edge): (usize, &Edge)| match edge.kind {
        EdgeKind::Closure if !except.contains(&index) => weights[index] * edge_chi_squared(edge, poses),
        _ => 0.0,
    };
    let misfits: Vec<f64> = graph.edges().iter().enumerate().map(misfit).collect();
    let worst = misfits.iter().copied().fold(0.0, f64::max);
    if worst <= settings.max_chi_squared {
        return false;
    }
    let limit = settings.max_chi_squared.max(0.5 * worst);
    for (weight, misfit) in weights.iter_mut().zip(misfits) {
        if misfit > limit {
            *weight = 0.0;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn what_a_dropped_closure_may_have_confirmed_is_weighed_again() {
        let (mut graph, settings) = (PoseGraph::new(), RobustSettings::default());
        for node in 0..4 {
            graph.add_node(Pose2::new(f64::from(node), 0.0, 0.0)).unwrap();
        }
        let steps = (0..3).map(|from| (from, from + 1, 1.0, EdgeKind::Odometry));
        // One that holds and one that does not.
        let closures = [(0, 3, 3.0, EdgeKind::Closure), (0, 2, 20.0, EdgeKind::Closure)];
        for (from, to, x, kind) in steps.chain(closures) {
            let edge = Edge {
                from,
                to,
                measurement: Pose2::new(x, 0.0, 0.0),
                information: Matrix3::identity() * 100.0,
                kind,
            };
            graph.add_edge(edge).unwrap();
        }
        let mut weighing = Weighing::new(&graph, &settings, &[], vec![1.0; 5], graph.poses().to_vec());
        weighing.is_sure[3] = true;
        weighing.fit(&DescentSettings::default(), &[]);
        assert_eq!(weighing.weights, [1.0, 1.0, 1.0, 1.0, 0.0]);
        assert!(!weighing.is_sure[3]);
    }

    #[test]
    fn a_trial_that_ends_no_lower_leaves_no_trace() {
        let (settings, descent) = (RobustSettings::default(), DescentSettings::default());
        // Forty metres straight on, a hundred closures that see anything anywhere, and one that no other confirms: accepted it lowers the
        // cost, until it is dropped again.
        let step = |i: u32| format!("EDGE_SE2 {i} {} 1 0 0 100 0 0 100 0 400\n", i + 1);
        let wrong = |i: u32| {
            let (x, y) = (f64::from(i * 7 % 13) - 20.0, f64::from(i * 5 % 11) - 5.0);
            format!("EDGE_SE2 {} {} {x} {y} 2 100 0 0 100 0 400\n", i % 20, 20 + i * 3 % 17)
        };
        let text: String = (0..40).map(step).chain((0..100).map(wrong)).collect();
        let text = text + "EDGE_SE2 0 40 40 12 0 100 0 0 100 0 400\n";
        let graph = crate::g2o::read(&text).unwrap().graph;
        let mut weights = vec![0.0; 141];
        weights[..40].fill(1.0);
        let mut weighing = Weighing::new(&graph, &settings, &[], weights, graph.poses().to_vec());
        weighing.settle(&descent);
        let before = (weighing.weights.clone(), weighing.poses.clone());
        assert_eq!(before.0[140], 0.0);
        weighing.try_against_the_others(&[140], &descent);
        assert_eq!((&weighing.weights, &weighing.poses), (&before.0, &before.1));
        assert!(!weighing.is_lone[140]);
    }
}
