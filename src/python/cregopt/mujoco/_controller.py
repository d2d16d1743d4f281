"""Whole-body control: inverse dynamics as a quadratic program, tracking the base, the feet and the forces of a plan.

With the accelerations of all degrees of freedom and the forces of the feet that touch the ground as unknowns x, the program is

    minimise    sum of weight * |A x - b|^2 over the tasks
    subject to  the dynamics of the base, friction pyramids, and the motors' torque limits, which yield where they cannot all be met.

The state is known exactly. The plan is changed in one way only: a swing starts where its foot is, and lands displaced by a part of the error of
the capture point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import _rotation
from ._engine import Floats, daqp
from ._model import Machine, State
from ._plan import Plan

GRAVITY = 9.80665
#: Share of a friction pyramid inside of the cone that forces use.
INSIDE = 0.95
#: Weight of all unknowns, so that they are determined.
TINY = 1e-5
#: Kinds of constraints as the solver has them.
EQUAL, BOUND, SOFT = 5, 0, 8
UNBOUNDED = 1e30


@dataclass(frozen=True)
class Gains:
    """What the controller can be tuned by.

    Attributes
    ----------
    base, attitude, swing : tuple of float
        Accelerations for errors of the base's position, of its attitude and of swinging feet, 1/s², and of their velocities, 1/s.
    stance : float
        Slowing of feet that stand, 1/s.
    rest : float
        Slowing of joints where nothing else moves them, 1/s.
    impedance : float
        Joint impedance: torque for an error of velocity, as a share of the joint's inertia, 1/s.
    weight_base, weight_attitude, weight_feet, weight_forces, weight_rest : float
        Weights of these tasks against one another.
    capture, displacement : float
        Share of the capture point's error by which footholds are displaced, and at most how far, m.
    decided : float
        From this share of a swing on it is not displaced further.
    press, seek : float
        Swings end so far below the ground, m, and feet that are late go down at so many m/s.
    near, bears : float
        A foot that is due touches the ground when it is so near, m, or bears so much, N.
    """

    base: tuple[float, float] = (120.0, 20.0)
    attitude: tuple[float, float] = (200.0, 28.0)
    swing: tuple[float, float] = (400.0, 40.0)
    stance: float = 40.0
    rest: float = 10.0
    impedance: float = 20.0
    weight_base: float = 30.0
    weight_attitude: float = 4.0
    weight_feet: float = 30.0
    weight_forces: float = 0.3
    weight_rest: float = 0.01
    capture: float = 0.7
    displacement: float = 0.1
    decided: float = 0.85
    press: float = 0.006
    seek: float = 0.1
    near: float = 0.004
    bears: float = 1.0


@dataclass(frozen=True)
class Command:
    """What the motors are to do until the next."""

    #: Torques, shape (joints,), N m.
    torque: Floats
    #: Joint velocities now and their change, rad/s and rad/s².
    velocity: Floats
    acceleration: Floats
    #: Torque for an error of velocity, shape (joints,), N m s.
    damping: Floats
    #: Whether the program had a solution.
    solved: bool

    def torque_after(self, time: float, velocity: Floats) -> Floats:
        """Torques so many seconds later, when the joints have a velocity."""
        return self.torque + self.damping * (self.velocity + self.acceleration * time - velocity)


def torque_range(limits: Floats, velocity: Floats, speed_limit: float) -> tuple[Floats, Floats]:
    """Least and largest torque of motors: what pushes on fades from two thirds of the largest speed to that.

    All arrays have the shape (joints,); N m, rad/s.
    """
    fade = np.clip((speed_limit - np.abs(velocity)) / (speed_limit / 3), 0.0, 1.0)
    return np.where(velocity < 0, -limits * fade, -limits), np.where(velocity > 0, limits * fade, limits)


class Controller:
    """Follows a plan with a robot; it remembers how far its feet are off."""

    def __init__(self, machine: Machine, plan: Plan, friction: float, speed_limit: float, gains: Gains) -> None:
        self.machine, self.plan, self.gains = machine, plan, gains
        self.friction, self.speed_limit = friction, speed_limit
        #: By how much each foot stood off its place when it last did, m, shape (feet, 3).
        self.off = np.zeros((plan.n_feet, 3))
        #: By how much each swing is displaced, m, shape (feet, 3).
        self.displaced = np.zeros((plan.n_feet, 3))

    def command(self, time: float, state: State, loads: Floats) -> Command:
        """Torques for a time of the plan, s, with the normal force on each foot, N, shape (feet,)."""
        plan, gains, machine = self.plan, self.gains, self.machine
        k = plan.index(time)
        # Before and behind the motion it stands still.
        moving = float(0 < time < plan.horizon)
        touching = [f for f, due in enumerate(plan.stands(k)) if due and (loads[f] > gains.bears or self._gap(f, k, state) < gains.near)]
        n_joints = len(state.velocity) - 6
        program = _Program(n_joints + 6, len(touching))
        dynamics = [state.inertia]
        for f, foot in enumerate(machine.feet):
            center, up = state.feet[f], plan.normals[k, f]
            if f in touching:
                self.off[f] = center - self._planned(f, k)
                jacobian, drift = machine.jacobian(foot, center - foot.radius * up)
                velocity = jacobian @ state.velocity
                program.motion(0, jacobian, -drift - gains.stance * velocity, gains.weight_feet)
                program.friction(dynamics, jacobian, up, INSIDE * self.friction / np.sqrt(2))
            else:
                jacobian, drift = machine.jacobian(foot, center)
                place, speed, push = self._swing(f, k, time, state)
                push = push + gains.swing[0] * (place - center) + gains.swing[1] * (speed - jacobian @ state.velocity)
                program.motion(0, jacobian, push - drift, gains.weight_feet)
        turn = _rotation.between(state.rotation, plan.rotation[k])
        spin = moving * plan.angular_velocity[k] - state.angular_velocity
        turning = moving * plan.angular_acceleration[k] + gains.attitude[0] * turn + gains.attitude[1] * spin
        # Turning is free acceleration 3 to 5, in the base's axes.
        program.motion(3, np.eye(3), state.rotation.T @ turning, gains.weight_attitude)
        if touching:
            away, drift = plan.position[k] - state.com, moving * plan.velocity[k] - state.com_velocity
            push = moving * plan.acceleration[k] + gains.base[0] * away + gains.base[1] * drift + [0, 0, GRAVITY]
            program.forces(np.tile(np.eye(3), len(touching)) / machine.mass, push, gains.weight_base)
            planned = plan.forces[k, touching].ravel() / machine.mass
            program.forces(np.eye(3 * len(touching)) / machine.mass, planned, gains.weight_forces)
        program.motion(6, np.eye(n_joints), -gains.rest * state.velocity[6:], gains.weight_rest)
        low, high = torque_range(machine.torque_limits, state.velocity[6:], self.speed_limit)
        solution = program.solve(np.hstack(dynamics), state.bias, low, high)
        if solution is None:
            torque, acceleration = -gains.rest * state.inertia.diagonal()[6:] * state.velocity[6:], np.zeros(n_joints)
        else:
            torque, acceleration = solution
        damping = gains.impedance * state.inertia.diagonal()[6:]
        return Command(torque, state.velocity[6:], acceleration, damping, solution is not None)

    def _planned(self, f: int, k: int) -> Floats:
        """Where the plan has the centre of a foot, m."""
        return self.plan.feet[k, f] + self.machine.feet[f].radius * self.plan.normals[k, f]  # type: ignore[no-any-return]

    def _gap(self, f: int, k: int, state: State) -> float:
        """Distance of a foot from the ground, m."""
        x, y, z = state.feet[f]
        return float((z - self.plan.terrain.height(x, y)) * self.plan.normals[k, f, 2]) - self.machine.feet[f].radius

    def _swing(self, f: int, k: int, time: float, state: State) -> tuple[Floats, Floats, Floats]:
        """Place, velocity and acceleration that the centre of a foot without contact should have."""
        plan, gains, up = self.plan, self.gains, self.plan.normals[k, f]
        phase = plan.phases[k, f]
        place = self._planned(f, k)
        if phase % 2 == 0:
            return place + self.displaced[f] - gains.press * up, -gains.seek * up, np.zeros(3)
        start, end = plan.edges[f][phase : phase + 2]
        share = float(np.clip((time - start) / (end - start), 0, 1))
        if share < gains.decided:
            self.displaced[f] = self._displacement(f, k, plan.index(end), state)
        blend, rate = share**2 * (3 - 2 * share), 6 * share * (1 - share) / (end - start)
        place = place + (1 - blend) * self.off[f] + blend * self.displaced[f]
        velocity = plan.feet_velocity[k, f] + rate * (self.displaced[f] - self.off[f])
        if share > 0.5:
            place, velocity = place - gains.press * (2 * share - 1) * up, velocity - 2 * gains.press / (end - start) * up
        return place, velocity, plan.feet_acceleration[k, f]

    def _displacement(self, f: int, k: int, landing: int, state: State) -> Floats:
        """By how much a foothold is displaced, m: the base is caught where it is about to come to rest."""
        plan = self.plan
        height = state.com[2] - state.feet[:, 2].min()
        fall_time = np.sqrt(max(float(height), 0.1 * float(plan.position[0, 2])) / GRAVITY)
        error = (state.com - plan.position[k]) + (state.com_velocity - plan.velocity[k]) * fall_time
        shift = self.gains.capture * error[:2]
        shift *= min(1.0, self.gains.displacement / max(float(np.linalg.norm(shift)), 1e-9))
        x, y = plan.feet[landing, f, :2]
        rise = plan.terrain.height(x + shift[0], y + shift[1]) - plan.terrain.height(x, y)
        return np.array([*shift, rise])


class _Program:
    """A quadratic program in accelerations, then forces of feet in contact."""

    def __init__(self, n_accelerations: int, n_contacts: int) -> None:
        self.n_accelerations, self.size = n_accelerations, n_accelerations + 3 * n_contacts
        self.hessian, self.gradient = TINY * np.eye(self.size), np.zeros(self.size)
        self.cones: list[Floats] = []

    def motion(self, first: int, task: Floats, wanted: Floats, weight: float) -> None:
        """Accelerations from ``first`` on that meet ``task x = wanted``."""
        columns = slice(first, first + task.shape[1])
        self.hessian[columns, columns] += weight * task.T @ task
        self.gradient[columns] -= weight * task.T @ wanted

    def forces(self, task: Floats, wanted: Floats, weight: float) -> None:
        """Forces that meet ``task x = wanted``."""
        self.motion(self.n_accelerations, task, wanted, weight)

    def friction(self, dynamics: list[Floats], jacobian: Floats, up: Floats, friction: float) -> None:
        """The next contact's pyramid, and its column of the dynamics."""
        across = _rotation.upright(up)
        cone = np.zeros((4, self.size))
        first = self.n_accelerations + 3 * len(self.cones)
        sides = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        cone[:, first : first + 3] = friction * up + sides @ across[:, :2].T
        self.cones.append(cone)
        dynamics.append(-jacobian.T)

    def solve(self, dynamics: Floats, bias: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats] | None:
        """Torques and accelerations of the joints; ``dynamics x + bias`` are the generalised forces of the motors."""
        n_cone = 4 * len(self.cones)
        rows = np.vstack([dynamics[:6], *self.cones, dynamics[6:]])
        lower = np.concatenate([-bias[:6], np.zeros(n_cone), low - bias[6:]])
        upper = np.concatenate([-bias[:6], np.full(n_cone, UNBOUNDED), high - bias[6:]])
        kinds = np.repeat([EQUAL, BOUND, SOFT], [6, n_cone, len(low)]).astype(np.int32)
        x, _, flag, _ = daqp.solve(self.hessian, self.gradient, rows, np.minimum(upper, UNBOUNDED), np.maximum(lower, -UNBOUNDED), kinds)
        if flag < 1 or not np.all(np.isfinite(x)):
            return None
        torque: Floats = np.clip((dynamics @ x + bias)[6:], low, high)
        return torque, x[6 : self.n_accelerations]
