"""Largest push that robots survive in MuJoCo: with the gait chosen online, with a trot planned again, and with a trot in open loop.

    python benches/pushes.py MODEL.xml... [--directions 12] [--steps 4] [--speed 0.5] [--json FILE]

A push of 0.1 s acts on the base of a robot that moves at --speed, 1.5 s after it began to; the robot must be upright 1.5 s later. The impulse per mass
is found by bisection, up to 4 N s/kg.
"""

from __future__ import annotations

import argparse
import json
import statistics
from typing import Any

import numpy as np

import cregopt.mujoco as cm

#: Duration of a push, its time and the end of the drive, s; largest impulse, N s/kg.
LENGTH, AT, END, MOST = 0.1, 2.0, 3.5, 4.0
TROT: dict[str, Any] = {"families": ["trot"], "change_durations": False}
MODES: dict[str, dict[str, Any]] = {
    "free": {},
    "trot": {"settings": TROT},
    "open loop": {"settings": TROT, "open_loop": True},
}


def survives(model: str, robot: Any, mode: dict[str, Any], speed: float, angle: float, impulse: float) -> bool:
    force = impulse * robot.mass / LENGTH
    push = (AT, (force * float(np.cos(angle)), force * float(np.sin(angle)), 0.0), LENGTH)
    commands = [((0.0, 0.0, 0.0), 0.5), ((speed, 0.0, 0.0), END - 0.5)]
    return cm.drive(model, commands, pushes=[push] if impulse else [], robot=robot, **mode).upright


def largest(model: str, robot: Any, mode: dict[str, Any], speed: float, angle: float, steps: int) -> float:
    low, high = 0.0, MOST
    for _ in range(steps):
        middle = (low + high) / 2
        if survives(model, robot, mode, speed, angle, middle):
            low = middle
        else:
            high = middle
    return low


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="+")
    parser.add_argument("--directions", type=int, default=12)
    parser.add_argument("--steps", type=int, default=4)
    parser.add_argument("--speed", type=float, default=0.5)
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    results = []
    for model in options.models:
        robot = cm.robot(model)
        row: dict[str, Any] = {"model": model.split("/")[-1], "mass": robot.mass}
        for name, mode in MODES.items():
            angles = np.arange(options.directions) * 2 * np.pi / options.directions
            row[name] = [largest(model, robot, mode, options.speed, float(angle), options.steps) for angle in angles]
            print(f"{row['model']} {name}: median {statistics.median(row[name]):.2f}, least {min(row[name]):.2f} N s/kg, {row[name]}", flush=True)
        results.append(row)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(results, file, indent=1)


if __name__ == "__main__":
    main()
