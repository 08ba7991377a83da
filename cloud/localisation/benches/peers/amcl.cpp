// Peer of the localiser: AMCL of beluga, with the defaults of its ROS node, on the same map, odometry and scans.
//
//   apt-get install libeigen3-dev librange-v3-dev libtbb-dev; the sources of Ekumen-OS/beluga and strasdat/Sophus
//   g++ -O3 -march=native -std=c++17 -DEIGEN_NO_DEBUG -DSOPHUS_USE_BASIC_LOGGING -I BELUGA/beluga/include -I SOPHUS -I /usr/include/eigen3
//     amcl.cpp -o amcl -ltbb
//   ./amcl node|each_scan SEED < LOG
//
// LOG, lengths in m and angles in rad:
//   map WIDTH HEIGHT RESOLUTION ORIGIN_X ORIGIN_Y CELLS     '#' occupied, '.' free, '?' unknown, row by row from the lower left
//   start X Y YAW                                           the robot's pose at the first scan, exact
//   scan X Y YAW LASER_X LASER_Y LASER_YAW ANGLE_MIN ANGLE_INCREMENT RANGE_MIN RANGE_MAX COUNT RANGE…   odometry first
// For each scan a line `X Y YAW MS UPDATED`: the pose, the processor time of this thread, and whether the filter was updated.
//
// `node`: a scan is used after 0.25 m or 0.2 rad; between updates odometry leads on from the last one. `each_scan`: every scan is used.

#include <beluga/algorithm/amcl_core.hpp>
#include <beluga/algorithm/cluster_based_estimation.hpp>
#include <beluga/beluga.hpp>
#include <beluga/views/take_evenly.hpp>

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <ctime>
#include <execution>
#include <iostream>
#include <string>
#include <utility>
#include <vector>

namespace {

/// A map as beluga reads it.
class Map : public beluga::BaseOccupancyGrid2<Map> {
 public:
  struct Traits {
    static bool is_free(std::int8_t value) { return value == 0; }
    static bool is_unknown(std::int8_t value) { return value < 0; }
    static bool is_occupied(std::int8_t value) { return value == 100; }
  };

  explicit Map(std::istream& in) {
    double x = 0, y = 0;
    std::string cells;
    in >> width_ >> height_ >> resolution_ >> x >> y >> cells;
    origin_ = Sophus::SE2d{0.0, Eigen::Vector2d{x, y}};
    for (const char cell : cells) data_.push_back(cell == '#' ? 100 : cell == '.' ? 0 : -1);
  }

  const Sophus::SE2d& origin() const { return origin_; }
  std::size_t size() const { return data_.size(); }
  const std::vector<std::int8_t>& data() const { return data_; }
  std::size_t width() const { return width_; }
  std::size_t height() const { return height_; }
  double resolution() const { return resolution_; }
  static Traits value_traits() { return {}; }

 private:
  std::size_t width_ = 0, height_ = 0;
  double resolution_ = 0;
  Sophus::SE2d origin_;
  std::vector<std::int8_t> data_;
};

/// A number; streams do not read `inf`.
double number(std::istream& in) {
  std::string word;
  in >> word;
  return std::strtod(word.c_str(), nullptr);
}

Sophus::SE2d pose(std::istream& in) {
  const double x = number(in), y = number(in), yaw = number(in);
  return {yaw, Eigen::Vector2d{x, y}};
}

struct Scan {
  Sophus::SE2d odometry, laser;
  double angle_min, angle_increment, range_min, range_max;
  std::vector<double> ranges;

  explicit Scan(std::istream& in)
      : odometry{pose(in)},
        laser{pose(in)},
        angle_min{number(in)},
        angle_increment{number(in)},
        range_min{number(in)},
        range_max{number(in)},
        ranges(static_cast<std::size_t>(number(in))) {
    for (double& range : ranges) range = number(in);
  }

  /// The end points of evenly spaced beams that met something, in the robot's frame.
  std::vector<std::pair<double, double>> points(std::size_t beams) const {
    std::vector<std::pair<double, double>> points;
    for (const int beam : ranges::views::iota(0, static_cast<int>(ranges.size())) | beluga::views::take_evenly(beams)) {
      const double range = ranges[static_cast<std::size_t>(beam)], angle = angle_min + beam * angle_increment;
      if (!(range >= range_min && range <= range_max)) continue;
      const Eigen::Vector2d point = laser * Eigen::Vector2d{range * std::cos(angle), range * std::sin(angle)};
      points.emplace_back(point.x(), point.y());
    }
    return points;
  }
};

/// This thread's processor time, ms: the machine may be shared.
double now() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
}

/// The filter with the defaults of beluga_amcl's node, which are nav2_amcl's where both have the parameter.
auto filter(const Map& map, bool each_scan) {
  beluga::AmclParams params;
  params.update_min_d = each_scan ? 0.0 : 0.25;
  params.update_min_a = each_scan ? 0.0 : 0.2;
  params.min_particles = 500;
  params.max_particles = 2000;
  params.alpha_slow = 0.0;
  params.alpha_fast = 0.0;
  params.kld_epsilon = 0.05;
  params.kld_z = 0.99;
  beluga::LikelihoodFieldModelParam field;
  field.max_obstacle_distance = 2.0;
  field.max_laser_distance = 100.0;
  field.z_hit = 0.5;
  field.z_random = 0.5;
  field.sigma_hit = 0.2;
  field.only_obstacle_boundaries = true;
  auto anywhere = [distribution = beluga::MultivariateUniformDistribution{map}]() mutable {
    return distribution(ranges::detail::get_random_engine());
  };
  return beluga::Amcl{
      beluga::DifferentialDriveModel2d{beluga::DifferentialDriveModelParam{0.2, 0.2, 0.2, 0.2}},
      beluga::LikelihoodFieldModel{field, map},
      std::move(anywhere),
      beluga::spatial_hash<Sophus::SE2d>{0.5, 0.5, 10 * Sophus::Constants<double>::pi() / 180},
      params,
      std::execution::seq};
}

}  // namespace

int main(int count, char** arguments) {
  std::ios::sync_with_stdio(false);
  std::string word;
  if (count < 3 || !(std::cin >> word) || word != "map") {
    std::cerr << "expected node|each_scan SEED, and a log that begins with a map\n";
    return 2;
  }
  const bool each_scan = arguments[1] == std::string{"each_scan"};
  ranges::detail::get_random_engine().seed(static_cast<std::uint32_t>(std::atoi(arguments[2])));
  const Map map(std::cin);
  auto amcl = filter(map, each_scan);
  std::cin >> word;
  // The node's default covariance for a start that it is told.
  amcl.initialize(pose(std::cin), Sophus::Matrix3d{1e-6 * Sophus::Matrix3d::Identity()});
  Sophus::SE2d map_from_odom;
  std::cout.precision(12);
  while (std::cin >> word) {
    const Scan scan(std::cin);
    const double begin = now();
    if (each_scan) amcl.force_update();
    const bool updated = amcl.update(scan.odometry, scan.points(60)).has_value();
    if (updated) {
      // What the node publishes, in place of the mean over all particles.
      const auto& particles = amcl.particles();
      const auto [mean, covariance] =
          beluga::cluster_based_estimate(beluga::views::states(particles), beluga::views::weights(particles));
      map_from_odom = mean * scan.odometry.inverse();
    }
    const double took = now() - begin;
    const Sophus::SE2d here = map_from_odom * scan.odometry;
    std::cout << here.translation().x() << ' ' << here.translation().y() << ' ' << here.so2().log() << ' ' << took << ' ' << updated
              << '\n';
  }
}
