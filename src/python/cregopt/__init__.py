"""Gait optimisation for legged robots: contact schedules with motions and contact forces, verified by an independent certificate.

>>> import cregopt
>>> task = cregopt.Task(cregopt.Robot("anymal"), cregopt.Terrain("flat"), goal=(2.0, 0.0))
>>> gait = cregopt.search(task, first=True)
>>> gait.feasible
True
>>> gait.sample(rate=100).forces.shape[1:]
(4, 3)

Searches on many machines: ``help("cregopt.distributed")``. Gaits that are chosen online, beside a controller: ``help(cregopt.Planner)``.

Units are SI, angles are in rad, and forces act on the robot. World frame: z up. Base frame: origin at the centre of mass, x forward, y left.
A schedule has one list per foot, in the robot's order of feet, of phase durations in s: stance, swing, stance, ..., stance.

Invalid input raises ``Error``, a ``ValueError`` whose message gives the place, the value and the limit. Files that cannot be read or written
raise ``OSError``.
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
    Plan,
    Planner,
    Robot,
    RobotState,
    Samples,
    Task,
    Terrain,
    Trajectory,
    Update,
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
    "Plan",
    "Planner",
    "Robot",
    "RobotState",
    "Samples",
    "Task",
    "Terrain",
    "Trajectory",
    "Update",
    "__version__",
    "evaluate",
    "search",
    "solve",
    "verify",
]
