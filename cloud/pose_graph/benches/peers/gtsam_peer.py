"""Peer of the pose graph: GTSAM's optimisers on the same graph, from the same start.

    python3 -m venv gtsam && gtsam/bin/pip install gtsam
    gtsam/bin/python gtsam_peer.py gauss_newton|levenberg_marquardt|gnc|huber RUNS LIMIT < GRAPH.g2o

Prints the median of RUNS processor times in ms (of all threads; after one run to warm up, if there are several), GTSAM's chi squared, and
`x y yaw` of each vertex. Reading is not timed; setting up the optimiser is. All vertices must be given.

`gauss_newton` and `levenberg_marquardt` are GTSAM's with their default parameters. `gnc` is `GncLMOptimizer` with truncated least squares:
edges between ids that differ by 1 are known to be true, and any other is false if its chi squared exceeds LIMIT. `huber` is
Levenberg-Marquardt with Huber's loss on those others.
"""

import sys
import tempfile
import time

import gtsam
import numpy as np


def read():
    """The graph and its start as `readG2o` has them; the first vertex is held by a prior, as in GTSAM's examples."""
    with tempfile.NamedTemporaryFile("w", suffix=".g2o") as file:
        file.writelines(line for line in sys.stdin if not line.startswith("FIX"))
        file.flush()
        graph, start = gtsam.readG2o(file.name, False)
    first = min(start.keys())
    held = gtsam.noiseModel.Diagonal.Variances(np.array([1e-6, 1e-6, 1e-8]))
    graph.add(gtsam.PriorFactorPose2(first, start.atPose2(first), held))
    return graph, start


def is_trusted(factor):
    """Whether it is odometry, or the prior."""
    keys = factor.keys()
    return len(keys) == 1 or abs(keys[0] - keys[1]) == 1


def with_huber(graph):
    """The same factors, with Huber's loss on those that may be false."""
    loss = gtsam.noiseModel.mEstimator.Huber.Create(1.345)
    robust = gtsam.NonlinearFactorGraph()
    for index in range(graph.size()):
        factor = graph.at(index)
        if not is_trusted(factor):
            model = gtsam.noiseModel.Robust.Create(loss, factor.noiseModel())
            first, second = factor.keys()
            factor = gtsam.BetweenFactorPose2(first, second, factor.measured(), model)
        robust.add(factor)
    return robust


def optimised(method, graph, start, limit):
    """The poses at which the method ends."""
    if method == "gauss_newton":
        optimiser = gtsam.GaussNewtonOptimizer(graph, start, gtsam.GaussNewtonParams())
    elif method in ("levenberg_marquardt", "huber"):
        optimiser = gtsam.LevenbergMarquardtOptimizer(graph, start, gtsam.LevenbergMarquardtParams())
    else:
        params = gtsam.GncLMParams()
        params.setLossType(gtsam.GncLossType.TLS)
        params.setKnownInliers([index for index in range(graph.size()) if is_trusted(graph.at(index))])
        optimiser = gtsam.GncLMOptimizer(graph, start, params)
        # GTSAM's cost is half of chi squared.
        optimiser.setInlierCostThresholds(limit / 2)
    return optimiser.optimize()


def main():
    method, runs, limit = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    graph, start = read()
    cost = with_huber(graph) if method == "huber" else graph
    times = []
    for _ in range(runs + 1 if runs > 1 else 1):
        begin = time.process_time()
        poses = optimised(method, cost, start, limit)
        times.append(time.process_time() - begin)
    print(1e3 * np.median(times[-runs:]), 2 * graph.error(poses))
    for key in sorted(poses.keys()):
        pose = poses.atPose2(key)
        print(repr(pose.x()), repr(pose.y()), repr(pose.theta()))


main()
