#!/usr/bin/env python3
"""A body of one's own: a robot with two driven wheels and a lidar, alone in a room of 4 m by 4 m.

    pip install eclipse-zenoh
    zenav up own_body.toml      # [robots.tiago] with model = "neato" and driver = true
    python3 edge/examples/body.py tiago tcp/127.0.0.1:7447
"""

import json
import math
import sys
import time

import zenoh

RADIUS, SEPARATION, LIDAR, HALF, TICK = 0.035, 0.248, -0.1, 2.0, 0.02  # m, m, m, m, s: those of the model `neato`
robot, router = sys.argv[1:]
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([router]))
wanted, heard, angles, swept, x, y, yaw = [0.0, 0.0], 0.0, [0.0, 0.0], [], 0.0, 0.0, 0.0


def hear(sample):
    global wanted, heard
    wanted, heard = json.loads(sample.payload.to_bytes())["wheels"], time.monotonic()


def wall(angle):
    """How far the lidar sees in a direction of the room."""
    at = ((x + LIDAR * math.cos(yaw), math.cos(angle)), (y + LIDAR * math.sin(yaw), math.sin(angle)))
    return min((math.copysign(HALF, way) - place) / way for place, way in at if abs(way) > 1e-9)


with zenoh.open(config) as session:
    commands = session.declare_subscriber(f"zenav/{robot}/edge/wheels", hear)
    readings = session.declare_publisher(f"zenav/{robot}/body/readings", encoding="application/json")
    tick, due = 0, time.monotonic()
    while True:
        if time.monotonic() - heard > 0.1:
            wanted = [0.0, 0.0]  # Nobody drives: the wheels stop.
        angles = [angle + speed * TICK for angle, speed in zip(angles, wanted)]
        left, right = (speed * RADIUS * TICK for speed in wanted)
        x, y = x + (left + right) / 2 * math.cos(yaw), y + (left + right) / 2 * math.sin(yaw)
        yaw += (right - left) / SEPARATION
        tick, due = tick + 1, due + TICK
        stamp = round(tick * TICK * 1e9)
        # The lidar turns once in ten ticks (`sweep_time` of the model).
        swept += [wall(yaw - math.pi + math.tau * beam / 360) for beam in range(len(swept), len(swept) + 36)]
        ranges, swept = (swept, []) if len(swept) == 360 else (None, swept)
        readings.put(json.dumps({
            "stamp": stamp, "wheels": angles, "imu": {"stamp": stamp, "yaw_rate": (right - left) / SEPARATION / TICK, "yaw": None},
            "sweep": ranges and {"stamp": stamp, "ranges": ranges},
            "bump": {"stamp": stamp, "pressed": False}, "battery": {"stamp": stamp, "charge": 1.0, "drawn_j": 0.0},
        }))
        time.sleep(max(0.0, due - time.monotonic()))
