"""Gaits of legged robots: which foot steps when, with a motion and contact forces that are checked.

>>> import cregopt
>>> task = cregopt.Task(cregopt.Robot("anymal"), cregopt.Terrain("flat"), goal=(2.0, 0.0))
>>> gait = cregopt.search(task, first=True)
>>> gait.feasible
True
>>> gait.sample(rate=100).forces.shape[1:]
(4, 3)

On many machines: ``help("cregopt.distributed")``.

Units are SI, angles rad, and forces act on the robot. World frame: z up; base frame: x forward, y left, in the centre of mass. Schedules are lists of
phase durations, s, a list for each foot in the robot's order: stance, swing, stance, ..., stance.

What cannot be raises ``Error``, a ``ValueError`` that names the place, the value and the limit; files that cannot be read or written raise ``OSError``.
"""

from ._cregopt import (
    ROBOTS,
    SCENARIOS,
    TERRAINS,
    Certificate,
    Error,
    Evaluation,
    Gait,
    Joints,
    Robot,
    Samples,
    Task,
    Terrain,
    Trajectory,
    __version__,
    verify,
)
from . import _pickle as _pickle
from ._search import evaluate, search, solve

__all__ = [
    "ROBOTS",
    "SCENARIOS",
    "TERRAINS",
    "Certificate",
    "Error",
    "Evaluation",
    "Gait",
    "Joints",
    "Robot",
    "Samples",
    "Task",
    "Terrain",
    "Trajectory",
    "__version__",
    "evaluate",
    "search",
    "solve",
    "verify",
]
