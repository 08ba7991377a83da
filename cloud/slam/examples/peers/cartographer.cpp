// Peer of SLAM: Cartographer's 2D core, with its own configuration files, on the same odometry and scans.
//
// On Debian 12, with the sources of cartographer-project/cartographer in CARTOGRAPHER, without what is for tests, pictures and files:
//   apt-get install cmake g++ libabsl-dev libboost-iostreams-dev libceres-dev libgflags-dev libgoogle-glog-dev liblua5.3-dev libprotobuf-dev ninja-build pkg-config protobuf-compiler
//   sed -i '/^google_enable_testing/d; /PKG_SEARCH_MODULE(CAIRO/d' CARTOGRAPHER/CMakeLists.txt
//   sed -i '/^file(GLOB_RECURSE ALL_TESTS/i list(FILTER ALL_LIBRARY_SRCS EXCLUDE REGEX "/ground_truth/|/io/.*(points_|color|draw|image|painter|writer|pbstream)")' CARTOGRAPHER/CMakeLists.txt
//   cmake -S CARTOGRAPHER -B BUILD -G Ninja -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_FLAGS=-DABSL_LEGACY_THREAD_ANNOTATIONS
//   ninja -C BUILD cartographer
//   g++ -O3 -DNDEBUG -DABSL_LEGACY_THREAD_ANNOTATIONS -I BUILD -I CARTOGRAPHER -I /usr/include/eigen3 -I /usr/include/lua5.3 cartographer.cpp BUILD/libcartographer.a $(pkg-config --libs protobuf absl_flat_hash_map absl_str_format absl_strings absl_synchronization absl_time) -lceres -lglog -lgflags -llua5.3 -lboost_iostreams -pthread -o cartographer
//   ./cartographer ceres|correlative odometry|scans < LOG
//
// `scan.h` says what LOG and the answer are. The time is that of all threads. A scan counts as used if it became a node.
//
// `correlative` searches for each scan before the Ceres matcher (use_online_correlative_scan_matching), `ceres` is the default. `scans` leaves
// odometry out. All else is as trajectory_builder_2d.lua, map_builder.lua and pose_graph.lua have it, but for the IMU, which the log has not,
// one thread for each of the pool and the solver, and no reports. A scan waits for the solve that it leads to, so that each run is the same.
// The pool's thread lowers its own priority: beside other programs a run takes long, but no more processor time.

#include <cartographer/common/config.h>
#include <cartographer/common/configuration_file_resolver.h>
#include <cartographer/common/lua_parameter_dictionary.h>
#include <cartographer/mapping/map_builder.h>
#include <cartographer/transform/transform.h>
#include <glog/logging.h>

#include <cmath>
#include <condition_variable>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "scan.h"

namespace {

using namespace cartographer;
using mapping::TrajectoryBuilderInterface;
using transform::Rigid3d;

const char* const ODOMETRY = "odometry";
// After it in the alphabet: of one stamp, Cartographer takes odometry first.
const char* const SCANS = "scans";

Rigid3d rigid(const Pose& pose) {
  return {{pose.x, pose.y, 0.0}, Eigen::AngleAxisd{pose.yaw, Eigen::Vector3d::UnitZ()}};
}

Pose pose(const Rigid3d& rigid) { return {rigid.translation().x(), rigid.translation().y(), transform::GetYaw(rigid)}; }

/// The beams that met something.
sensor::TimedPointCloudData points(const Scan& scan, common::Time time) {
  const auto base_from_laser = rigid(scan.laser).cast<float>();
  sensor::TimedPointCloudData points{time, base_from_laser.translation(), {}, {}};
  for (std::size_t beam = 0; beam < scan.ranges.size(); ++beam) {
    const double range = scan.ranges[beam], angle = scan.angle(beam);
    if (!(range > scan.range_min && range < scan.range_max)) continue;
    const Eigen::Vector3d point{range * std::cos(angle), range * std::sin(angle), 0.0};
    points.ranges.push_back({base_from_laser * point.cast<float>(), 0.0F});
  }
  return points;
}

std::string configuration(bool correlative) {
  return R"(
    include "map_builder.lua"
    include "trajectory_builder.lua"
    MAP_BUILDER.use_trajectory_builder_2d = true
    MAP_BUILDER.num_background_threads = 1
    POSE_GRAPH.optimization_problem.ceres_solver_options.num_threads = 1
    POSE_GRAPH.constraint_builder.log_matches = false
    POSE_GRAPH.log_residual_histograms = false
    TRAJECTORY_BUILDER_2D.use_imu_data = false
    TRAJECTORY_BUILDER_2D.use_online_correlative_scan_matching = )" +
         std::string{correlative ? "true" : "false"} + R"(
    return {map_builder = MAP_BUILDER, trajectory_builder = TRAJECTORY_BUILDER})";
}

/// Solves of the pose graph, which its thread counts.
class Solves {
 public:
  void add() {
    const std::lock_guard<std::mutex> lock{mutex_};
    ++count_;
    added_.notify_all();
  }
  void wait_for(int count) {
    std::unique_lock<std::mutex> lock{mutex_};
    added_.wait(lock, [&] { return count_ >= count; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable added_;
  int count_ = 0;
};

/// Where local SLAM saw a scan: relative to its last node until then.
struct Place {
  bool known = false, is_node = false;
  mapping::NodeId node{0, 0};
  Rigid3d from_node;
  Rigid3d online;
};

void run(const std::vector<Scan>& scans, bool correlative, bool with_odometry, std::ostream& answers) {
  common::LuaParameterDictionary parameters{
      configuration(correlative), std::make_unique<common::ConfigurationFileResolver>(
                                      std::vector<std::string>{std::string{common::kSourceDirectory} + "/configuration_files"})};
  const auto builder_options = mapping::CreateMapBuilderOptions(parameters.GetDictionary("map_builder").get());
  const auto trajectory_options = mapping::CreateTrajectoryBuilderOptions(parameters.GetDictionary("trajectory_builder").get());
  const auto now = [] { return processor_time(CLOCK_PROCESS_CPUTIME_ID); };

  Solves solves;
  mapping::MapBuilder builder{builder_options};
  auto& graph = *builder.pose_graph();
  graph.SetGlobalSlamOptimizationCallback([&](const auto&, const auto&) { solves.add(); });
  const int nodes_a_solve = builder_options.pose_graph_options().optimize_every_n_nodes();

  std::vector<Place> places(scans.size());
  std::map<common::Time, std::size_t> indices;
  int solves_due = 0, nodes_since = 0;
  mapping::NodeId last_node{0, 0};
  Rigid3d local_from_node;
  const auto matched = [&](int trajectory, common::Time time, const Rigid3d& local, const auto&,
                           std::unique_ptr<const TrajectoryBuilderInterface::InsertionResult> node) {
    if (node != nullptr) {
      last_node = node->node_id;
      local_from_node = local;
      if (++nodes_since > nodes_a_solve) {
        nodes_since = 0;
        solves.wait_for(++solves_due);
      }
    }
    places[indices.at(time)] = {true, node != nullptr, last_node, local_from_node.inverse() * local,
                                graph.GetLocalToGlobalTransform(trajectory) * local};
  };

  using SensorId = TrajectoryBuilderInterface::SensorId;
  std::set<SensorId> sensors{{SensorId::SensorType::RANGE, SCANS}};
  if (with_odometry) sensors.insert({SensorId::SensorType::ODOMETRY, ODOMETRY});
  const int trajectory = builder.AddTrajectoryBuilder(sensors, trajectory_options, matched);
  auto& inputs = *builder.GetTrajectoryBuilder(trajectory);

  std::vector<double> took;
  double begin = now();
  const auto lap = [&] {
    const double end = now();
    took.push_back(end - begin);
    begin = end;
  };
  for (std::size_t i = 0; i < scans.size(); ++i) {
    const auto time = common::FromUniversal(0) + common::FromSeconds(scans[i].stamp - scans[0].stamp);
    indices[time] = i;
    if (with_odometry) inputs.AddSensorData(ODOMETRY, sensor::OdometryData{time, rigid(scans[i].odometry)});
    inputs.AddSensorData(SCANS, points(scans[i], time));
    lap();
  }
  builder.FinishTrajectory(trajectory);
  graph.RunFinalOptimization();
  lap();
  const auto nodes = graph.GetTrajectoryNodePoses();

  // Odometry leads on to a scan that local SLAM did not take.
  for (std::size_t i = 0; i < scans.size(); ++i) {
    if (!places[i].known) {
      CHECK_GT(i, 0U) << "the first scan was not taken";
      const auto step = rigid(scans[i - 1].odometry).inverse() * rigid(scans[i].odometry);
      places[i] = {false, false, places[i - 1].node, places[i - 1].from_node * step, places[i - 1].online * step};
    }
    write(answers, pose(places[i].online), took[i], places[i].is_node);
  }
  double finish = took.back();
  for (const auto& place : places) {
    write(answers, pose(nodes.at(place.node).global_pose * place.from_node), finish, false);
    finish = 0.0;
  }
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 3) {
    std::cerr << "expected ceres|correlative odometry|scans\n";
    return 2;
  }
  FLAGS_logtostderr = true;
  FLAGS_minloglevel = google::GLOG_ERROR;
  std::ios::sync_with_stdio(false);
  // Cartographer writes its progress there.
  std::ostream answers{std::cout.rdbuf(std::cerr.rdbuf())};
  answers.precision(12);
  std::vector<Scan> scans;
  for (std::string word; std::cin >> word;) scans.emplace_back(std::cin);
  run(scans, arguments[1] == std::string{"correlative"}, arguments[2] == std::string{"odometry"}, answers);
  answers.flush();
}
