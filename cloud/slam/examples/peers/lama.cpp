// Peer of SLAM: LaMa, with the defaults of its ROS nodes, on the same odometry and scans.
//
//   apt-get install libeigen3-dev cmake; the sources of iris-ua/iris_lama
//   cmake -S LAMA -B BUILD -DCMAKE_BUILD_TYPE=Release && make -C BUILD
//   g++ -O3 -DNDEBUG -std=c++14 -I LAMA/include -I /usr/include/eigen3 lama.cpp BUILD/src/libiris_lama.a -pthread -o lama
//   ./lama slam|particles|graph node|each_scan SEED < LOG
//
// `scan.h` says what LOG and the answer are. The time is that of this thread. `particles` and `graph` finish: with the poses of the best
// particle's path, and of the graph.
//
// `slam` is Slam2D, which closes no loops, `particles` PFSlam2D with 30 particles, `graph` GraphSlam2D.
// `node`: a scan is used after the way or turn that the node waits for; between updates odometry leads on from the last one.
// `each_scan`: every scan is used. All else is as the node has it, also that beams beyond 16 m are left out.

#include <lama/graph_slam2d.h>
#include <lama/pf_slam2d.h>
#include <lama/slam2d.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "scan.h"

namespace {

// LaMa's `a + b` is b, which is relative to a, in the frame of a; `a - b` is b relative to a.
using lama::Pose2D;

Pose2D pose2d(const Pose& pose) { return {pose.x, pose.y, pose.yaw}; }

/// The beams that met something, as far as the nodes look by default.
lama::PointCloudXYZ::Ptr points(const Scan& scan) {
  auto cloud = std::make_shared<lama::PointCloudXYZ>();
  cloud->sensor_origin_ = {scan.laser.x, scan.laser.y, 0.0};
  cloud->sensor_orientation_ = Eigen::AngleAxisd{scan.laser.yaw, Eigen::Vector3d::UnitZ()};
  cloud->points.reserve(scan.ranges.size());
  for (std::size_t beam = 0; beam < scan.ranges.size(); ++beam) {
    const double range = scan.ranges[beam], angle = scan.angle(beam);
    if (!(range > scan.range_min && range < std::min(scan.range_max, 16.0))) continue;
    cloud->points.emplace_back(range * std::cos(angle), range * std::sin(angle), 0.0);
  }
  return cloud;
}

double now() { return processor_time(CLOCK_THREAD_CPUTIME_ID); }

/// LaMa's own defaults, with the way and turn after which a scan is used; `each_scan` uses one that did not move, too.
template <class Options>
Options waiting(bool each_scan, double way, double turn) {
  Options options;
  options.trans_thresh = each_scan ? -1.0 : way;
  options.rot_thresh = each_scan ? -1.0 : turn;
  return options;
}

struct Slam {
  lama::Slam2D slam;

  Slam(bool each_scan, std::uint32_t) : slam{waiting<lama::Slam2D::Options>(each_scan, 0.01, 0.25)} {}

  bool update(const Scan& scan) {
    return slam.enoughMotion(pose2d(scan.odometry)) && slam.update(points(scan), pose2d(scan.odometry), 0.0);
  }
  Pose2D pose() const { return slam.getPose(); }
  std::vector<Pose2D> finish() { return {}; }
};

struct Particles {
  lama::PFSlam2D slam;

  Particles(bool each_scan, std::uint32_t seed) : slam{options(each_scan, seed)} {}

  static lama::PFSlam2D::Options options(bool each_scan, std::uint32_t seed) {
    auto options = waiting<lama::PFSlam2D::Options>(each_scan, 0.5, 0.25);
    options.particles = 30;
    options.seed = seed;
    return options;
  }

  bool update(const Scan& scan) { return slam.update(points(scan), pose2d(scan.odometry), 0.0); }
  Pose2D pose() const { return slam.getPose(); }
  std::vector<Pose2D> finish() {
    const auto& poses = slam.getParticles()[slam.getBestParticleIdx()].poses;
    return {poses.begin(), poses.end()};
  }
};

struct Graph {
  lama::GraphSlam2D slam;
  /// For each update its key pose, and the pose relative to that.
  std::vector<std::pair<std::size_t, Pose2D>> updates;

  Graph(bool each_scan, std::uint32_t) : slam{options(each_scan)} {}

  static lama::GraphSlam2D::Options options(bool each_scan) {
    auto options = waiting<lama::GraphSlam2D::Options>(each_scan, 0.25, 0.25);
    options.key_pose_distance = 0.5;
    options.key_pose_head_delay = 3;
    options.loop_search_max_distance = 15.0;
    options.loop_search_min_distance = 5.0;
    options.loop_closure_scan_rmse = 0.075;
    return options;
  }

  bool update(const Scan& scan) {
    if (!slam.enoughMotion(pose2d(scan.odometry)) || !slam.update(points(scan), pose2d(scan.odometry), 0.0)) return false;
    updates.emplace_back(slam.key_poses.size() - 1, slam.key_poses.back().original - slam.slam->getPose());
    return true;
  }
  Pose2D pose() const { return slam.getPose(); }
  std::vector<Pose2D> finish() {
    slam.optimizePoseGraph();
    std::vector<Pose2D> poses;
    for (const auto& update : updates) poses.push_back(slam.key_poses[update.first].pose + update.second);
    return poses;
  }
};

void write(const Pose2D& pose, double ms, bool updated) {
  ::write(std::cout, {pose.x(), pose.y(), pose.rotation()}, ms, updated);
}

template <class Method>
void run(bool each_scan, std::uint32_t seed) {
  Method method{each_scan, seed};
  Pose2D updated_at, last;
  // For each scan the number of updates, and the way since the last one.
  std::vector<std::pair<std::size_t, Pose2D>> scans;
  std::size_t updates = 0;
  for (std::string word; std::cin >> word;) {
    const Scan scan{std::cin};
    const double begin = now();
    const bool updated = method.update(scan);
    if (updated) {
      last = method.pose();
      updated_at = pose2d(scan.odometry);
      ++updates;
    }
    const double took = now() - begin;
    scans.emplace_back(updates, updated_at - pose2d(scan.odometry));
    write(last + scans.back().second, took, updated);
  }
  const double begin = now();
  const auto finished = method.finish();
  double took = now() - begin;
  if (finished.empty()) return;
  for (const auto& scan : scans) {
    write(finished[scan.first - 1] + scan.second, took, false);
    took = 0.0;
  }
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 4) {
    std::cerr << "expected slam|particles|graph node|each_scan SEED\n";
    return 2;
  }
  std::ios::sync_with_stdio(false);
  std::cout.precision(12);
  const std::string method = arguments[1];
  const bool each_scan = arguments[2] == std::string{"each_scan"};
  const auto seed = static_cast<std::uint32_t>(std::atoi(arguments[3]));
  (method == "graph" ? run<Graph> : method == "particles" ? run<Particles> : run<Slam>)(each_scan, seed);
}
