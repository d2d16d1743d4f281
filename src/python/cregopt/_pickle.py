"""Registers how ``pickle`` and ``copy`` copy the package's objects, so that they can be sent to other processes."""

from __future__ import annotations

import copyreg
from typing import Any, Optional

from ._cregopt import Evaluation, Robot, Task, Terrain, Trajectory

_World = dict[str, Any]


def parts(task: Task) -> dict[str, Any]:
    """Content of a task as numbers, texts, lists and dictionaries."""
    return {
        "robot": task.robot.to_dict(),
        "terrain": task.terrain.to_dict(),
        "start": task.start,
        "goal": task.goal,
        "via": task.via,
        "force_limit": task.force_limit,
        "scenario": task.scenario,
    }


def of_parts(
    robot: _World,
    terrain: _World,
    start: _World,
    goal: _World,
    via: list[_World],
    force_limit: Optional[float],
    scenario: tuple[Optional[str], Optional[int]],
) -> Task:
    """Task with the given content; the inverse of :func:`parts`."""
    world = (Robot._again(robot), Terrain.from_dict(terrain))
    task = Task(*world, goal, start=start, via=via, force_limit=force_limit)
    name, target = scenario
    return task if name is None else task._named(name, target)


def _motion(description: dict[str, Any], force_limit: Optional[float]) -> Trajectory:
    return Trajectory.from_dict(description)._limited(force_limit)


def _columns(found: Evaluation) -> tuple[Any, ...]:
    arrays = (found.feasible, found.n_violated, found.max_violation, found.cost, found.iterations, found.horizon)
    return (*arrays, found.trajectories)


# The copy of a robot omits the report of its URDF import, ``Robot.imported``. A task omits it as well.
copyreg.pickle(Robot, lambda robot: (Robot._again, (robot.to_dict(),)))
copyreg.pickle(Terrain, lambda terrain: (Terrain.from_dict, (terrain.to_dict(),)))
copyreg.pickle(Task, lambda task: (of_parts, tuple(parts(task).values())))
copyreg.pickle(Trajectory, lambda motion: (_motion, (motion.to_dict(), motion._force_limit)))
copyreg.pickle(Evaluation, lambda found: (Evaluation, _columns(found)))
