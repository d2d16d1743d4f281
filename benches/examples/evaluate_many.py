"""Evaluation: a hundred trots of ANYmal with other durations, as one batch."""

import cregopt
import numpy as np


def trot(swing: float, stance: float, strides: int) -> list[list[float]]:
    """Durations per foot, s: stance, swing, stance, ..., stance. The diagonals alternate."""
    first = [0.2] + [swing, stance] * (strides - 1) + [swing, stance + 0.2]
    second = [0.2 + (swing + stance) / 2] + [swing, stance] * (strides - 1) + [swing, 0.2 + (stance - swing) / 2]
    return [first, second, second, first]


task = cregopt.Task(cregopt.Robot("anymal"), cregopt.Terrain("flat"), goal=(1.0, 0.0))
grid = [(swing, stance) for swing in np.linspace(0.08, 0.35, 10) for stance in np.linspace(0.36, 0.72, 10)]
found = cregopt.evaluate(task, [trot(swing, stance, 4) for swing, stance in grid], device="cpu")
best = int(np.nanargmin(np.where(found.feasible, found.cost, np.nan)))
print(f"{found.feasible.sum()} of {len(found)} are certified")
print(f"cheapest: swing {grid[best][0]:.2f} s, stance {grid[best][1]:.2f} s, cost {found.cost[best]:.3f}")
