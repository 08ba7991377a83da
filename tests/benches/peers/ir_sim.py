"""Peer of the simulator: IR-SIM, one robot with a lidar in the same world, by the same clock.

    pip install ir-sim
    python ir_sim.py WORLD.toml RADIUS BEAMS FIELD_OF_VIEW RANGE_MAX SECONDS

WORLD is a world file of polygons and walls. The robot stands where `[start]` says and turns in small circles; every step of 20 ms takes a
whole scan, as IR-SIM does. Prints steps a second of this thread's processor time.
"""

import math
import sys
import tempfile
import time
import tomllib

import irsim
import numpy
import yaml


def rectangle(wall):
    """A wall's corners, counter-clockwise."""
    (ax, ay), (bx, by) = wall["from"], wall["to"]
    length = math.hypot(bx - ax, by - ay)
    half = 0.5 * wall["thickness"] / length
    x, y = -(by - ay) * half, (bx - ax) * half
    return [[ax - x, ay - y], [bx - x, by - y], [bx + x, by + y], [ax + x, ay + y]]


def main():
    path, radius, beams, field_of_view, range_max, seconds = sys.argv[1:]
    with open(path, "rb") as file:
        world = tomllib.load(file)
    solids = [polygon["points"] for polygon in world.get("polygon", [])]
    solids += [rectangle(wall) for wall in world.get("wall", [])]
    start = world["start"]
    scene = {
        "world": {
            "width": world["size"][0],
            "height": world["size"][1],
            "step_time": 0.02,
            "sample_time": 0.02,
            "offset": world.get("origin", [0, 0]),
            "collision_mode": "stop",
        },
        "robot": [
            {
                "kinematics": {"name": "diff"},
                "shape": {"name": "circle", "radius": float(radius)},
                "state": [start["x"], start["y"], start.get("yaw", 0.0)],
                "vel_max": [1.0, 2.0],
                "sensors": [
                    {
                        "name": "lidar2d",
                        "range_min": 0.02,
                        "range_max": float(range_max),
                        "angle_range": float(field_of_view),
                        "number": int(beams),
                    }
                ],
            }
        ],
        "obstacle": [
            {"shape": {"name": "polygon", "vertices": points}, "state": [0, 0, 0]}
            for points in solids
        ],
    }
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        yaml.safe_dump(scene, file)
        file.flush()
        environment = irsim.make(file.name, headless=True, log_level="ERROR")
    action = numpy.array([[0.2], [0.5]])
    for _ in range(3):
        environment.step(action)
    steps, seen, begin = 0, 0, time.thread_time()
    while time.thread_time() - begin < float(seconds):
        environment.step(action)
        steps += 1
        seen += sum(value < float(range_max) - 1e-6 for value in environment.get_lidar_scan()["ranges"][:8])
    took = time.thread_time() - begin
    if seen == 0:
        sys.exit("the lidar saw nothing")
    print(f"{steps / took:.3f} {irsim.__version__}")


main()
