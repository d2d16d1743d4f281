"""Reference for the controller: a trajectory sampled at the control rate, with accelerations."""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from .. import Error, Gait, Robot, Samples, Task, Terrain, Trajectory
from . import _rotation
from ._engine import Floats

#: Motions that can be played.
Motion = Union[Trajectory, Gait, dict[str, Any], str, "os.PathLike[str]"]

#: Distance to each side over which the slope of the ground under a foothold is measured, m.
SLOPE_BASE = 0.02
#: Speed below which the base is at rest, m/s and rad/s. The last instant can be a step before the end of a motion.
REST = 0.05


@dataclass(frozen=True)
class Plan:
    """Motion at ``n`` equidistant instants, world frame, SI units."""

    robot: Robot
    terrain: Terrain
    #: Duration of the motion, s, and time between instants, s.
    horizon: float
    step: float
    #: Position, velocity and acceleration of the centre of mass, shape (n, 3). The acceleration is that of the planned forces.
    position: Floats
    velocity: Floats
    acceleration: Floats
    #: Rotation matrices from base to world, shape (n, 3, 3); angular velocity and acceleration, shape (n, 3).
    rotation: Floats
    angular_velocity: Floats
    angular_acceleration: Floats
    #: Contact points of the feet (in swing: the points that would touch the ground), their velocities and accelerations, shape (n, feet, 3).
    feet: Floats
    feet_velocity: Floats
    feet_acceleration: Floats
    #: Unit vectors from the contact points to the centres of the foot balls, or normals of the soles, shape (n, feet, 3).
    normals: Floats
    #: Yaws of the soles and their rates, shape (n, feet); 0 for feet without soles.
    yaws: Floats
    yaw_rates: Floats
    #: Forces of the ground on the feet, and its moments on soles about their centres, shape (n, feet, 3); no moment without soles.
    forces: Floats
    moments: Floats
    #: Index of the phase of each foot, shape (n, feet): even for stance, odd for swing.
    phases: NDArray[np.int64]
    #: Boundaries of the phases per foot, s, shape (phases + 1,).
    edges: list[Floats]

    @property
    def n_feet(self) -> int:
        """Number of feet."""
        return int(self.feet.shape[1])

    def index(self, time: float) -> int:
        """Index of the instant nearest to a time, s; the first instant before the motion and the last one after it."""
        return int(np.clip(round(time / self.step), 0, len(self.position) - 1))

    @property
    def soled(self) -> bool:
        """True if the feet are soles."""
        return "sole" in self.robot.to_dict()

    def sole(self, index: int, foot: int) -> Floats:
        """Attitude of a sole: columns forward, left and up, world frame, shape (3, 3)."""
        return _rotation.upright(self.normals[index, foot], self.yaws[index, foot])

    def stands(self, index: int) -> NDArray[np.bool_]:
        """True for feet in planned stance, shape (feet,)."""
        stands: NDArray[np.bool_] = self.phases[index] % 2 == 0
        return stands

    def rests(self, index: int) -> bool:
        """True if all feet stand and the base is at rest."""
        speed = max(float(np.abs(of[index]).max()) for of in (self.velocity, self.angular_velocity))
        return bool(self.stands(index).all()) and speed < REST


def read(motion: Motion, rate: float) -> Plan:
    """Plan of a motion, sampled at ``rate``, Hz. Raises Error if the motion is too short or has no robot or terrain."""
    if isinstance(motion, Gait):
        trajectory = motion.trajectory
    elif isinstance(motion, Trajectory):
        trajectory = motion
    elif isinstance(motion, dict):
        trajectory = Trajectory.from_dict(motion)
    else:
        trajectory = Trajectory.from_file(motion)
    robot, terrain = _world(trajectory)
    plan = of_samples(trajectory.sample(rate), robot, terrain, trajectory.schedule, trajectory.horizon, rate)
    if plan.soled and not all("yaws" in foot for foot in trajectory.to_dict()["ee"]):
        raise Error(f"the motion has no yaws and moments of the feet, although the feet of the robot {robot.name} are soles")
    return plan


def of_samples(samples: Samples, robot: Robot, terrain: Terrain, schedule: list[list[float]], horizon: float, rate: float) -> Plan:
    """Plan of a motion that was sampled at ``rate``, Hz, with its phase durations and its duration, s."""
    # A last sample at the end of the motion is left out if it is nearer to the one before than the others.
    inside = slice(0, int(np.floor(horizon * rate + 1e-9)) + 1)
    forces, step = samples.forces[inside], 1 / rate
    if len(forces) < 3:
        raise Error(f"the motion lasts {horizon:.3g} s, too short to be played")
    edges = [_edges(durations) for durations in schedule]
    times = samples.time[inside]
    phases = np.stack([np.clip(np.searchsorted(edge, times + 1e-9, side="right") - 1, 0, len(edge) - 2) for edge in edges], axis=1)
    gravity = np.array([0.0, 0.0, -9.80665])
    angular_velocity = samples.base_angular_velocity[inside]
    feet, feet_velocity, yaws = samples.feet_position[inside], samples.feet_velocity[inside], samples.yaws[inside]
    return Plan(
        robot=robot,
        terrain=terrain,
        horizon=horizon,
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
        yaws=yaws,
        yaw_rates=np.gradient(yaws, step, axis=0),
        forces=forces,
        moments=samples.moments[inside],
        phases=phases,
        edges=edges,
    )


def _edges(durations: list[float]) -> Floats:
    """Boundaries of the phases, s. If the foot lands after the end, the last boundary is its landing."""
    edges = np.concatenate([[0.0], np.cumsum(durations)])
    return edges[:-1] if durations[-1] <= 0 else edges


def _world(trajectory: Trajectory) -> tuple[Robot, Terrain]:
    """Robot and terrain of a motion, given by name or in full, or those of its scenario."""
    given = trajectory.to_dict()
    robot, terrain = given.get("robot"), given.get("terrain")
    scenario = given.get("scenario")
    if robot is None or terrain is None:
        if scenario is None:
            raise Error("the motion has no robot or no terrain, and no scenario that has them")
        task = Task.from_scenario(scenario)
        robot, terrain = robot or task.robot.to_dict(), terrain or task.terrain.to_dict()
    return (
        Robot.from_dict(robot) if isinstance(robot, dict) else Robot(robot),
        Terrain.from_dict(terrain) if isinstance(terrain, dict) else Terrain(terrain),
    )


def normal(terrain: Terrain, x: float, y: float) -> Floats:
    """Unit normal of the ground at (x, y), world frame."""
    dx = terrain.height(x + SLOPE_BASE, y) - terrain.height(x - SLOPE_BASE, y)
    dy = terrain.height(x, y + SLOPE_BASE) - terrain.height(x, y - SLOPE_BASE)
    up = np.array([-dx, -dy, 2 * SLOPE_BASE])
    return up / float(np.linalg.norm(up))


def _normals(terrain: Terrain, feet: Floats, phases: NDArray[np.int64]) -> Floats:
    """Normals of the ground at the footholds, shape (n, feet, 3); interpolated during a swing."""
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
    """Index of the model's foot for each foot of the plan, by the smallest sum of horizontal distances.

    ``planned`` and ``standing``: positions of the feet, base frame, m, shape (feet, 3).
    """
    away = np.linalg.norm(planned[:, None, :2] - standing[None, :, :2], axis=2)
    orders = itertools.permutations(range(len(planned)))
    return list(min(orders, key=lambda order: sum(away[foot, of] for foot, of in enumerate(order))))
