"""Default gaits of a robot on soles over flat ground, steps and slopes, played in MuJoCo.

    python benches/humanoids.py MODEL [--robot FILE] [--tasks NAME,...] [--seeds N] [--seed N]

MODEL is a MuJoCo model or a URDF file. Each gait is searched with the defaults of ``cregopt solve`` for the robot of FILE (default: made from the
model), and played with disturbances by each seed. Prints a table.
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Callable, Optional

import cregopt
import cregopt.mujoco
import numpy as np

CELL, FRICTION, STEP, SLOPE = 0.025, 0.8, 0.1, math.tan(math.radians(15))

#: Height of the ground along x, None for flat ground; goal (x, y), m, and yaw, rad.
TASKS: dict[str, tuple[Optional[Callable[[float], float]], tuple[float, float], float]] = {
    "stand": (None, (0.0, 0.0), 0.0),
    "1 m": (None, (1.0, 0.0), 0.0),
    "3 m": (None, (3.0, 0.0), 0.0),
    "1 m sideways": (None, (0.0, 1.0), 0.0),
    "half turn": (None, (0.0, 0.0), math.pi),
    "1 m backwards": (None, (-1.0, 0.0), 0.0),
    "step at 0.45 m, riser 0.1 m": (lambda x: ramp(x, 0.45, 0.1), (1.0, 0.0), 0.0),
    "step at 0.55 m, riser 0.1 m": (lambda x: ramp(x, 0.55, 0.1), (1.0, 0.0), 0.0),
    "step at 0.45 m, riser 0.025 m": (lambda x: ramp(x, 0.45, 0.025), (1.0, 0.0), 0.0),
    "step at 0.55 m, riser 0.025 m": (lambda x: ramp(x, 0.55, 0.025), (1.0, 0.0), 0.0),
    "slope": (lambda x: SLOPE * x, (1.0, 0.0), 0.0),
    "slope from 0.3 m": (lambda x: SLOPE * max(x - 0.3, 0.0), (1.0, 0.0), 0.0),
    "slope of 1 m": (lambda x: SLOPE * min(max(x - 0.3, 0.0), 1.0), (2.0, 0.0), 0.0),
    "slope down": (lambda x: -SLOPE * x, (1.0, 0.0), 0.0),
}


def ramp(x: float, start: float, width: float) -> float:
    """Height of a step of STEP whose riser is as wide as ``width``, m."""
    return STEP * min(max((x - start) / width, 0.0), 1.0)


def terrain(height: Optional[Callable[[float], float]]) -> cregopt.Terrain:
    if height is None:
        return cregopt.Terrain("flat", friction=FRICTION)
    x = np.round(np.arange(-2.0, 5.0 + 1e-9, CELL), 6)
    heights = np.array([height(at) for at in x])[:, None] * np.ones(160)
    return cregopt.Terrain.heights(heights, cell=CELL, origin=(-2.0, -2.0), friction=FRICTION)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model")
    parser.add_argument("--robot", help="robot file, as of `cregopt robot import` [default: made from the model]")
    parser.add_argument("--tasks", help="names of tasks [default: all]")
    parser.add_argument("--seeds", type=int, default=3, help="number of plays of each gait [default: 3]")
    parser.add_argument("--seed", type=int, default=1, help="seed of the searches [default: 1]")
    options = parser.parse_args()
    robot = cregopt.Robot.from_file(options.robot) if options.robot else cregopt.mujoco.robot(options.model)
    print("| task | found | s | cost | upright | off the plan, cm | slip in a stance, cm | time at a torque limit, % |\n|---|---|---|---|---|---|---|---|")
    for name in options.tasks.split(",") if options.tasks else TASKS:
        height, goal, yaw = TASKS[name]
        begun = time.perf_counter()
        gait = cregopt.search(cregopt.Task(robot, terrain(height), goal=goal, yaw=yaw), seed=options.seed, device="cpu")
        line = f"| {name} | {'yes' if gait.feasible else 'no'} | {time.perf_counter() - begun:.1f} | "
        if gait.feasible and gait.cost is not None:
            plays = [cregopt.mujoco.play(gait, options.model, seed=seed) for seed in range(1, options.seeds + 1)]
            worst = [max(getattr(play, what) for play in plays) for what in ("position_error_max", "slip_max", "torque_saturated")]
            upright = sum(play.upright for play in plays)
            line += f"{gait.cost['total']:.2f} | {upright} of {len(plays)} | " + " | ".join(f"{100 * value:.1f}" for value in worst) + " |"
        print(line, flush=True)


if __name__ == "__main__":
    main()
