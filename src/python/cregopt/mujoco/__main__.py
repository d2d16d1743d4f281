"""Command line ``python -m cregopt.mujoco``; see ``--help``."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Optional, Sequence

from .. import Error
from . import play, robot

UPRIGHT, FALLEN, BAD_INPUT = 0, 3, 4


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m cregopt.mujoco",
        description="Plays a plan of `cregopt solve` on a robot in MuJoCo and reports the result, or writes the robot file for planning.",
        epilog="Exit codes: 0 upright to the end, 2 usage, 3 fallen, 4 bad file or MuJoCo missing.",
    )
    parser.add_argument("trajectory", nargs="?", help="the plan: trajectory.json")
    parser.add_argument("--model", required=True, metavar="FILE", help="MuJoCo model of the robot")
    parser.add_argument("--feet", metavar="NAME,...", help="geoms, bodies or sites that are the feet, in the plan's order [default: found]")
    parser.add_argument("--friction", type=float, help="friction coefficient of the ground [default: the plan's]")
    parser.add_argument("--seed", type=int, help="seed of small disturbances of start, masses and friction [default: none]")
    parser.add_argument("--speed-limit", type=float, default=30.0, metavar="RAD/S", help="joint speed at which the motors have no torque left [default: 30]")
    parser.add_argument("--video", metavar="FILE", help="write an animation: .gif, .png or .webp")
    parser.add_argument("--viewer", action="store_true", help="show the simulation in a window")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    parser.add_argument("--robot", metavar="FILE", help="instead of playing, write the model's robot file for `cregopt solve --robot`: .json or .toml")
    return parser


def main(given: Optional[Sequence[str]] = None) -> int:
    parser = arguments()
    options = parser.parse_args(given)
    if (options.trajectory is None) == (options.robot is None):
        parser.error("give either a trajectory or --robot")
    feet = options.feet.split(",") if options.feet else None
    try:
        if options.robot is not None:
            made = robot(options.model, feet)
            made.save(options.robot)
            print(f"{options.robot}: {made.mass:.2f} kg, {made.feet} feet")
            return UPRIGHT
        report = play(
            options.trajectory,
            options.model,
            feet=feet,
            friction=options.friction,
            seed=options.seed,
            speed_limit=options.speed_limit,
            video=options.video,
            viewer=options.viewer,
        )
    except (Error, ImportError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return BAD_INPUT
    print(json.dumps(report.to_dict(), indent=1, allow_nan=False) if options.json else report)
    return UPRIGHT if report.upright else FALLEN


if __name__ == "__main__":
    sys.exit(main())
