// Peer of the sampling planners: OMPL's, on the same maps, queries and exact checks, in the same processor time.
//
//   apt-get install libompl-dev libeigen3-dev
//   g++ -O3 -march=native -std=c++17 -pthread -I/usr/include/ompl-1.5 -I/usr/include/eigen3 ompl.cpp -o ompl -lompl
//   ./ompl MAP QUERIES rrt|rrt_connect|rrt_star|informed|bit_star SECONDS RESULTS [SEED]
//
// MAP is a Moving AI map ('.', 'G' and 'S' are free); QUERIES are lines `sx sy gx gy [optimum]`, cells counted from the top left;
// RESULTS are lines `time_us length found expansions first_us first_length simplify_us simplified_length`, times of this thread's
// processor clock, lengths in cells. `rrt` and `rrt_connect` end with the first solution, the others after SECONDS. The time limit is a flag
// that another thread sets: the planner asks no clock.

#include <ompl/base/MotionValidator.h>
#include <ompl/base/PlannerTerminationCondition.h>
#include <ompl/base/objectives/PathLengthOptimizationObjective.h>
#include <ompl/base/spaces/RealVectorStateSpace.h>
#include <ompl/geometric/SimpleSetup.h>
#include <ompl/geometric/planners/informedtrees/BITstar.h>
#include <ompl/geometric/planners/rrt/InformedRRTstar.h>
#include <ompl/geometric/planners/rrt/RRT.h>
#include <ompl/geometric/planners/rrt/RRTConnect.h>
#include <ompl/geometric/planners/rrt/RRTstar.h>
#include <ompl/util/Console.h>
#include <ompl/util/RandomNumbers.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iostream>
#include <limits>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace base = ompl::base;
namespace geometric = ompl::geometric;

namespace {

/// Free cells, one byte each.
class Map {
 public:
  explicit Map(const char* path) {
    std::ifstream in(path);
    std::string word;
    while (in >> word && word != "map") {
      if (word == "height") in >> height_;
      else if (word == "width") in >> width_;
      else in >> word;
    }
    std::string row;
    std::getline(in, row);
    for (int y = 0; y < height_ && std::getline(in, row); ++y)
      for (int x = 0; x < width_; ++x) {
        const char c = x < static_cast<int>(row.size()) ? row[x] : '@';
        cells_.push_back(c == '.' || c == 'G' || c == 'S');
      }
    cells_.resize(static_cast<std::size_t>(width_) * height_);
  }

  int width() const { return width_; }
  int height() const { return height_; }

  bool free(int x, int y) const {
    return x >= 0 && y >= 0 && x < width_ && y < height_ && cells_[static_cast<std::size_t>(y) * width_ + x];
  }

  /// Whether a straight way touches free cells only: every cell between entry and exit, both neighbours where it leaves by a corner.
  bool sees(double ax, double ay, double bx, double by) const {
    int x = static_cast<int>(std::floor(ax)), y = static_cast<int>(std::floor(ay));
    const int last_x = static_cast<int>(std::floor(bx)), last_y = static_cast<int>(std::floor(by));
    if (!free(x, y)) return false;
    const double dx = bx - ax, dy = by - ay;
    const int step_x = dx < 0 ? -1 : 1, step_y = dy < 0 ? -1 : 1;
    constexpr double never = std::numeric_limits<double>::infinity();
    // Shares of the way from one column, one row, to the next, and to the first border.
    const double each_x = dx == 0 ? never : std::abs(1 / dx), each_y = dy == 0 ? never : std::abs(1 / dy);
    double next_x = dx == 0 ? never : (dx < 0 ? ax - x : x + 1 - ax) * each_x;
    double next_y = dy == 0 ? never : (dy < 0 ? ay - y : y + 1 - ay) * each_y;
    for (int left = std::abs(last_x - x) + std::abs(last_y - y); left > 0; --left) {
      if (std::abs(next_x - next_y) < 1e-12) {
        if (!free(x + step_x, y) || !free(x, y + step_y)) return false;
        x += step_x;
        y += step_y;
        next_x += each_x;
        next_y += each_y;
        --left;
      } else if (next_x < next_y) {
        x += step_x;
        next_x += each_x;
      } else {
        y += step_y;
        next_y += each_y;
      }
      if (!free(x, y)) return false;
    }
    return true;
  }

 private:
  int width_ = 0, height_ = 0;
  std::vector<std::uint8_t> cells_;
};

const double* at(const base::State* state) { return state->as<base::RealVectorStateSpace::StateType>()->values; }

/// OMPL's motion check, exact instead of stepwise.
class ExactMotion : public base::MotionValidator {
 public:
  ExactMotion(const base::SpaceInformationPtr& space, const Map& map) : MotionValidator(space), map_(map) {}

  bool checkMotion(const base::State* a, const base::State* b) const override {
    const double *p = at(a), *q = at(b);
    return map_.sees(p[0], p[1], q[0], q[1]);
  }

  bool checkMotion(const base::State* a, const base::State* b, std::pair<base::State*, double>& last) const override {
    if (checkMotion(a, b)) return true;
    if (last.first != nullptr) si_->copyState(last.first, a);
    last.second = 0;
    return false;
  }

 private:
  const Map& map_;
};

double seconds(clockid_t clock) {
  timespec t{};
  clock_gettime(clock, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

/// This thread's processor time, s: the machine may be shared.
double now() { return seconds(CLOCK_THREAD_CPUTIME_ID); }

/// A flag that is set when the process has used its processor time.
class Watch {
 public:
  Watch() : thread_([this] {
    while (!done_.load(std::memory_order_relaxed)) {
      std::this_thread::sleep_for(std::chrono::microseconds(500));
      if (seconds(CLOCK_PROCESS_CPUTIME_ID) >= until_.load(std::memory_order_relaxed))
        stop_.store(true, std::memory_order_relaxed);
    }
  }) {}

  ~Watch() {
    done_.store(true, std::memory_order_relaxed);
    thread_.join();
  }

  void arm(double limit) {
    until_.store(seconds(CLOCK_PROCESS_CPUTIME_ID) + limit, std::memory_order_relaxed);
    stop_.store(false, std::memory_order_relaxed);
  }

  base::PlannerTerminationCondition condition() const {
    return base::PlannerTerminationCondition([this] { return stop_.load(std::memory_order_relaxed); });
  }

 private:
  std::atomic<double> until_{std::numeric_limits<double>::infinity()};
  std::atomic<bool> stop_{false}, done_{false};
  std::thread thread_;
};

base::PlannerPtr make(const std::string& name, const base::SpaceInformationPtr& space) {
  if (name == "rrt") return std::make_shared<geometric::RRT>(space);
  if (name == "rrt_connect") return std::make_shared<geometric::RRTConnect>(space);
  if (name == "rrt_star") return std::make_shared<geometric::RRTstar>(space);
  if (name == "informed") return std::make_shared<geometric::InformedRRTstar>(space);
  if (name == "bit_star") return std::make_shared<geometric::BITstar>(space);
  return nullptr;
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 6) {
    std::cerr << "expected MAP QUERIES rrt|rrt_connect|rrt_star|informed|bit_star SECONDS RESULTS [SEED]\n";
    return 2;
  }
  ompl::msg::setLogLevel(ompl::msg::LOG_ERROR);
  ompl::RNG::setSeed(count > 6 ? std::strtoul(arguments[6], nullptr, 10) : 1);
  const Map map(arguments[1]);
  const std::string name = arguments[3];
  const double limit = std::atof(arguments[4]);
  const bool improves = name != "rrt" && name != "rrt_connect";
  auto plane = std::make_shared<base::RealVectorStateSpace>(2);
  base::RealVectorBounds bounds(2);
  bounds.setLow(0);
  bounds.setHigh(0, map.width());
  bounds.setHigh(1, map.height());
  plane->setBounds(bounds);

  Watch watch;
  std::ifstream queries(arguments[2]);
  std::ofstream results(arguments[5]);
  std::string line;
  while (std::getline(queries, line)) {
    std::istringstream words(line);
    int sx = 0, sy = 0, gx = 0, gy = 0;
    if (line.empty() || line[0] == '#' || !(words >> sx >> sy >> gx >> gy)) continue;
    geometric::SimpleSetup setup(plane);
    const auto space = setup.getSpaceInformation();
    setup.setStateValidityChecker([&map](const base::State* state) {
      const double* p = at(state);
      return map.free(static_cast<int>(std::floor(p[0])), static_cast<int>(std::floor(p[1])));
    });
    space->setMotionValidator(std::make_shared<ExactMotion>(space, map));
    base::ScopedState<> start(plane), goal(plane);
    start[0] = sx + 0.5;
    start[1] = sy + 0.5;
    goal[0] = gx + 0.5;
    goal[1] = gy + 0.5;
    // Within half a cell of the goal counts, in favour of the planners that meet it by chance.
    setup.setStartAndGoalStates(start, goal, 0.5);
    if (improves) setup.setOptimizationObjective(std::make_shared<base::PathLengthOptimizationObjective>(space));
    const auto planner = make(name, space);
    if (planner == nullptr) {
      std::cerr << "unknown planner " << name << '\n';
      return 2;
    }
    setup.setPlanner(planner);
    setup.setup();

    watch.arm(limit);
    const double begin = now();
    double first = -1, first_length = -1;
    setup.getProblemDefinition()->setIntermediateSolutionCallback(
        [&](const base::Planner*, const std::vector<const base::State*>&, const base::Cost cost) {
          if (first < 0) {
            first = now() - begin;
            first_length = cost.value();
          }
        });
    const auto status = planner->solve(watch.condition());
    const double took = now() - begin;
    const bool found = status == base::PlannerStatus::EXACT_SOLUTION;
    const double length = found ? setup.getSolutionPath().length() : -1;
    if (found && first < 0) {
      first = took;
      first_length = length;
    }
    base::PlannerData data(space);
    planner->getPlannerData(data);
    double simplified = -1;
    const double begin_simplify = now();
    if (found) {
      watch.arm(limit);
      setup.simplifySolution(watch.condition());
      simplified = setup.getSolutionPath().length();
    }
    const double simplify = now() - begin_simplify;
    results << 1e6 * took << ' ' << length << ' ' << (found ? 1 : 0) << ' ' << data.numVertices() << ' ' << 1e6 * first << ' '
            << first_length << ' ' << 1e6 * simplify << ' ' << simplified << std::endl;
  }
}
