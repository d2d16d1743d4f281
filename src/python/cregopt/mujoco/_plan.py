"""A trajectory as a controller follows it: sampled at the rate of control, with accelerations."""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from .. import Error, Gait, Robot, Task, Terrain, Trajectory
from . import _rotation
from ._engine import Floats

#: What can be played.
Motion = Union[Trajectory, Gait, dict[str, Any], str, "os.PathLike[str]"]

#: Slopes of the ground under a foothold are measured over so many m to each side.
SLOPE_BASE = 0.02


@dataclass(frozen=True)
class Plan:
    """A motion at ``n`` instants of even distance, world frame, SI units."""

    robot: Robot
    terrain: Terrain
    #: Time from the start to the end, s, and time between instants, s.
    horizon: float
    step: float
    #: Centre of mass, its velocity and acceleration, shape (n, 3); the acceleration is what the forces give.
    position: Floats
    velocity: Floats
    acceleration: Floats
    #: Base to world, shape (n, 3, 3); angular velocity and acceleration, shape (n, 3).
    rotation: Floats
    angular_velocity: Floats
    angular_acceleration: Floats
    #: Where the feet touch the ground or would, their velocities and accelerations, shape (n, feet, 3).
    feet: Floats
    feet_velocity: Floats
    feet_acceleration: Floats
    #: Directions in which the centres of their balls are from there, unit vectors, shape (n, feet, 3).
    normals: Floats
    #: Forces of the ground on the feet, shape (n, feet, 3).
    forces: Floats
    #: Number of each foot's phase, shape (n, feet): even numbers are stances.
    phases: NDArray[np.int64]
    #: Begin and end of each phase of each foot, s.
    edges: list[Floats]

    @property
    def n_feet(self) -> int:
        return int(self.feet.shape[1])

    def index(self, time: float) -> int:
        """Number of the instant nearest to a time, the first before and the last behind the motion."""
        return int(np.clip(round(time / self.step), 0, len(self.position) - 1))

    def stands(self, index: int) -> NDArray[np.bool_]:
        """Which feet stand, shape (feet,)."""
        stands: NDArray[np.bool_] = self.phases[index] % 2 == 0
        return stands


def read(motion: Motion, rate: float) -> Plan:
    """A motion at ``rate`` instants a second."""
    if isinstance(motion, Gait):
        trajectory = motion.trajectory
    elif isinstance(motion, Trajectory):
        trajectory = motion
    elif isinstance(motion, dict):
        trajectory = Trajectory.from_dict(motion)
    else:
        trajectory = Trajectory.from_file(motion)
    robot, terrain = _world(trajectory)
    samples = trajectory.sample(rate)
    # The last instant is the end, at a distance of its own.
    inside = slice(0, int(np.floor(trajectory.horizon * rate + 1e-9)) + 1)
    forces, step = samples.forces[inside], 1 / rate
    if len(forces) < 3:
        raise Error(f"the motion lasts {trajectory.horizon:.3g} s, too short to be played")
    edges = [np.concatenate([[0.0], np.cumsum(durations)]) for durations in trajectory.schedule]
    times = samples.time[inside]
    phases = np.stack([np.clip(np.searchsorted(edge, times + 1e-9, side="right") - 1, 0, len(edge) - 2) for edge in edges], axis=1)
    gravity = np.array([0.0, 0.0, -9.80665])
    angular_velocity = samples.base_angular_velocity[inside]
    feet, feet_velocity = samples.feet_position[inside], samples.feet_velocity[inside]
    return Plan(
        robot=robot,
        terrain=terrain,
        horizon=trajectory.horizon,
        step=step,
        position=samples.base_position[inside],
        velocity=samples.base_velocity[inside],
        acceleration=forces.sum(1) / robot.mass + gravity,
        rotation=_rotation.of_quaternions(samples.base_quaternion[inside]),
        angular_velocity=angular_velocity,
        angular_acceleration=np.gradient(angular_velocity, step, axis=0),
        feet=feet,
        feet_velocity=feet_velocity,
        feet_acceleration=np.gradient(feet_velocity, step, axis=0),
        normals=_normals(terrain, feet, phases),
        forces=forces,
        phases=phases,
        edges=edges,
    )


def _world(trajectory: Trajectory) -> tuple[Robot, Terrain]:
    """Robot and terrain of a motion, by name or in full, its own or its scenario's."""
    given = trajectory.to_dict()
    robot, terrain = given.get("robot"), given.get("terrain")
    scenario = given.get("scenario")
    if robot is None or terrain is None:
        if scenario is None:
            raise Error("the motion names no robot or no terrain, and no scenario that has them")
        task = Task.from_scenario(scenario)
        robot, terrain = robot or task.robot.to_dict(), terrain or task.terrain.to_dict()
    return (
        Robot.from_dict(robot) if isinstance(robot, dict) else Robot(robot),
        Terrain.from_dict(terrain) if isinstance(terrain, dict) else Terrain(terrain),
    )


def normal(terrain: Terrain, x: float, y: float) -> Floats:
    """Unit normal of the ground, world frame."""
    dx = terrain.height(x + SLOPE_BASE, y) - terrain.height(x - SLOPE_BASE, y)
    dy = terrain.height(x, y + SLOPE_BASE) - terrain.height(x, y - SLOPE_BASE)
    up = np.array([-dx, -dy, 2 * SLOPE_BASE])
    return up / float(np.linalg.norm(up))


def _normals(terrain: Terrain, feet: Floats, phases: NDArray[np.int64]) -> Floats:
    """The ground's normals at footholds; through a swing from one to the next."""
    normals = np.tile([0.0, 0.0, 1.0], (*feet.shape[:2], 1))
    for foot, numbers in enumerate(phases.T):
        starts = np.flatnonzero(np.diff(numbers, prepend=-1))
        ends = np.append(starts[1:], len(numbers))
        of_stances = {int(numbers[i]): normal(terrain, *feet[i, foot, :2]) for i in starts if numbers[i] % 2 == 0}
        for start, end in zip(starts, ends):
            phase = int(numbers[start])
            before = of_stances.get(phase - phase % 2, normals[0, foot])
            after = of_stances.get(phase + phase % 2, before)
            share = (np.arange(start, end) - start)[:, None] / (end - start)
            between = (1 - share) * before + share * after
            normals[start:end, foot] = between / np.linalg.norm(between, axis=1, keepdims=True)
    return normals


def order_of_feet(planned: Floats, standing: Floats) -> list[int]:
    """Which foot of a model is which of the plan, by where they stand; both shape (feet, 3), base frame, m."""
    away = np.linalg.norm(planned[:, None, :2] - standing[None, :, :2], axis=2)
    orders = itertools.permutations(range(len(planned)))
    return list(min(orders, key=lambda order: sum(away[foot, of] for foot, of in enumerate(order))))
