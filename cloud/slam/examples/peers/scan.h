// What the peers of SLAM read and write.
//
// A log, lengths in m and angles in rad, a line for each scan:
//   scan SECS X Y YAW LASER_X LASER_Y LASER_YAW ANGLE_MIN ANGLE_INCREMENT RANGE_MIN RANGE_MAX COUNT RANGE…
// SECS is its stamp, X Y YAW odometry.
// The answer for each scan is a line `X Y YAW MS UPDATED`: the pose, the processor time, and whether the peer used the scan.
// Methods that finish then write such lines once more, with the poses that all scans together lead to. The time of that is the first line's.

#pragma once

#include <cstddef>
#include <cstdlib>
#include <ctime>
#include <istream>
#include <ostream>
#include <string>
#include <vector>

/// A number; streams do not read `inf`.
inline double number(std::istream& in) {
  std::string word;
  in >> word;
  return std::strtod(word.c_str(), nullptr);
}

struct Pose {
  double x, y, yaw;

  static Pose read(std::istream& in) {
    const double x = number(in), y = number(in), yaw = number(in);
    return {x, y, yaw};
  }
};

struct Scan {
  double stamp;
  Pose odometry, laser;
  double angle_min, angle_increment, range_min, range_max;
  std::vector<double> ranges;

  /// What follows the word `scan`.
  explicit Scan(std::istream& in)
      : stamp{number(in)},
        odometry{Pose::read(in)},
        laser{Pose::read(in)},
        angle_min{number(in)},
        angle_increment{number(in)},
        range_min{number(in)},
        range_max{number(in)},
        ranges(static_cast<std::size_t>(number(in))) {
    for (double& range : ranges) range = number(in);
  }

  double angle(std::size_t beam) const { return angle_min + static_cast<double>(beam) * angle_increment; }
};

inline void write(std::ostream& out, const Pose& pose, double ms, bool updated) {
  out << pose.x << ' ' << pose.y << ' ' << pose.yaw << ' ' << ms << ' ' << updated << '\n';
}

/// Processor time, ms: the machine may be shared. Of this thread with `CLOCK_THREAD_CPUTIME_ID`, of all with `CLOCK_PROCESS_CPUTIME_ID`.
inline double processor_time(clockid_t clock) {
  timespec t{};
  clock_gettime(clock, &t);
  return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
}
