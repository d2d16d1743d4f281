"""Whole-body control: inverse dynamics as a quadratic program that tracks the base, the feet and the forces of a plan.

The unknowns x are the accelerations of all degrees of freedom and the forces of the feet in contact. The program is

    minimise    sum of weight * |A x - b|^2 over the tasks
    subject to  the dynamics of the base, friction pyramids, and, as soft constraints, the motors' torque limits.

The state is known exactly. The plan is followed with one change: a swing starts at the actual position of its foot, and its foothold is displaced by the
error of the capture point. With a smaller displacement errors across the line between two standing feet grow from step to step: a trot of Go2 over 3 m,
whose base was 2 mm off after half of the way, fell before its end with a share of 0.7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import _rotation
from ._engine import Floats, daqp
from ._model import Machine, State
from ._plan import Plan

GRAVITY = 9.80665
#: Share of the friction pyramid inside the cone within which forces stay, and of a sole within which its centre of pressure stays.
INSIDE, PRESSED = 0.95, 0.9
#: Largest force that the controller learns, as a share of the weight; moments: times the height of the base.
UNKNOWN = 0.3
#: Weight that pulls every unknown to zero, so that the solution is unique.
TINY = 1e-5
#: Codes of the kinds of constraints in DAQP.
EQUAL, BOUND, SOFT = 5, 0, 8
UNBOUNDED = 1e30


@dataclass(frozen=True)
class Gains:
    """Gains and weights of the controller.

    Attributes
    ----------
    base, attitude, swing : tuple of float
        Gains on the errors of the base position, of the base attitude and of the swing feet: on position, 1/s², and on velocity, 1/s.
    stance : float
        Damping of the velocity of stance feet, 1/s.
    rest : float
        Damping of joint velocities that no other task determines, 1/s.
    posture : tuple of float
        Gains on the errors of joints that belong to no leg, such as those of arms, from their positions in the stance: 1/s² and 1/s.
    impedance : float
        Joint damping: torque per velocity error and inertia of the joint, 1/s.
    weight_base, weight_attitude, weight_feet, weight_soles, weight_forces, weight_rest : float
        Relative weights of the tasks; ``weight_soles`` for the rotation of soles, ``weight_rest`` for ``rest`` and ``posture``. With a small one
        the arms take up the angular momentum of swinging legs, which plans of a rigid body leave out.
    capture, displacement : float
        Share of the capture point error by which footholds are displaced, and largest displacement, m.
    decided : float
        Share of the swing duration after which its foothold is no longer displaced.
    press, seek : float
        Depth below the ground at which swings end, m, and speed at which late feet move down, m/s.
    near, bears : float
        Distance from the ground, m, below which a foot in planned stance counts as in contact, and normal force, N, above which it does.
    mapped : bool
        True if the ground is where the plan has it; else it is only where a foot bore load in this stance.
    unknown : float
        Time in which the controller learns forces and moments on the base that it does not know, such as those of a load, s; 0: never.
    """

    base: tuple[float, float] = (120.0, 20.0)
    attitude: tuple[float, float] = (200.0, 28.0)
    swing: tuple[float, float] = (400.0, 40.0)
    stance: float = 40.0
    rest: float = 10.0
    posture: tuple[float, float] = (100.0, 20.0)
    impedance: float = 20.0
    weight_base: float = 30.0
    weight_attitude: float = 4.0
    weight_feet: float = 30.0
    weight_soles: float = 3.0
    weight_forces: float = 0.3
    weight_rest: float = 0.01
    capture: float = 1.0
    displacement: float = 0.1
    decided: float = 0.85
    press: float = 0.006
    seek: float = 0.1
    near: float = 0.004
    bears: float = 1.0
    mapped: bool = True
    unknown: float = 0.0


#: Gains for robots on soles. The ankles carry little of the angular momentum of swinging legs: the attitude gives way to it, not the height.
ON_SOLES = Gains(weight_attitude=0.3)


@dataclass(frozen=True)
class Command:
    """Command to the motors until the next command."""

    #: Torques, shape (joints,), N m.
    torque: Floats
    #: Joint velocities at the time of the command, and commanded joint accelerations, shape (joints,), rad/s and rad/s².
    velocity: Floats
    acceleration: Floats
    #: Torque per velocity error, shape (joints,), N m s.
    damping: Floats
    #: True if the quadratic program had a solution.
    solved: bool

    def torque_after(self, time: float, velocity: Floats) -> Floats:
        """Torques, N m, at ``time`` seconds after the command, when the joint velocities are ``velocity``, rad/s."""
        return self.torque + self.damping * (self.velocity + self.acceleration * time - velocity)


def torque_range(limits: Floats, velocity: Floats, speed_limit: float) -> tuple[Floats, Floats]:
    """Smallest and largest torque of motors. An accelerating torque fades to zero between two thirds of the speed limit and the limit.

    All arrays have shape (joints,); N m, rad/s.
    """
    fade = np.clip((speed_limit - np.abs(velocity)) / (speed_limit / 3), 0.0, 1.0)
    return np.where(velocity < 0, -limits * fade, -limits), np.where(velocity > 0, limits * fade, limits)


class Controller:
    """Controller that follows a plan with a robot. Its state is the offset of each foot from the plan."""

    def __init__(self, machine: Machine, plan: Plan, friction: float, speed_limit: float, gains: Gains) -> None:
        self.machine, self.plan, self.gains = machine, plan, gains
        self.friction, self.speed_limit = friction, speed_limit
        #: Offset of each foot from its planned position during its last contact, m, shape (feet, 3).
        self.off = np.zeros((plan.n_feet, 3))
        #: Displacement of the foothold at which each swing ends, m, shape (feet, 3).
        self.displaced = np.zeros((plan.n_feet, 3))
        #: Position of each foot when it last bore load in this stance, m, shape (feet, 3); NaN before it does.
        self.ground = np.array([self._planned(f, 0) if stands else np.full(3, np.nan) for f, stands in enumerate(plan.stands(0))])
        #: Force on the base, N, and moment, base axes, N m, that the dynamics lack.
        self.unknown = np.zeros(6)
        #: Velocities and commanded accelerations of the degrees of freedom at the last command.
        self.last: tuple[Floats, Floats] | None = None

    def follow(self, plan: Plan) -> None:
        """Follows another plan from now on, which starts at the actual positions of the feet."""
        self.plan = plan
        self.off[~plan.stands(0)] = 0
        self.displaced[:] = 0

    def command(self, time: float, state: State, loads: Floats) -> Command:
        """Command at a time of the plan, s. ``loads``: normal force on each foot, N, shape (feet,)."""
        plan, gains, machine = self.plan, self.gains, self.machine
        k = plan.index(time)
        # Before and after the motion the reference is at rest. A plan made in motion moves from its first instant on.
        moving = float(-plan.step / 2 < time < plan.horizon)
        touching = [f for f, due in enumerate(plan.stands(k)) if self._touches(f, k, bool(due), state, float(loads[f]))]
        n_joints = len(state.velocity) - 6
        self._learn(state)
        points = {f: self.contact_points(f, k, state) for f in touching}
        program = _Program(n_joints + 6, sum(map(len, points.values())))
        dynamics = [state.inertia]
        for f, foot in enumerate(machine.feet):
            center, up = state.feet[f], plan.normals[k, f]
            if f in touching:
                self.off[f] = center - self._planned(f, k)
                jacobian, drift = machine.jacobian(foot, center - foot.radius * up)
                velocity = jacobian @ state.velocity
                program.motion(0, jacobian, -drift - gains.stance * velocity, gains.weight_feet)
                for point in points[f]:
                    program.friction(dynamics, machine.jacobian(foot, point)[0], up, INSIDE * self.friction / np.sqrt(2))
            else:
                jacobian, drift = machine.jacobian(foot, center)
                place, speed, push = self._swing(f, k, time, state)
                push = push + gains.swing[0] * (place - center) + gains.swing[1] * (speed - jacobian @ state.velocity)
                program.motion(0, jacobian, push - drift, gains.weight_feet)
            if foot.sole is not None:
                self._turn_sole(program, f, k, state, f in touching)
        turn = _rotation.between(state.rotation, plan.rotation[k])
        spin = moving * plan.angular_velocity[k] - state.angular_velocity
        turning = moving * plan.angular_acceleration[k] + gains.attitude[0] * turn + gains.attitude[1] * spin
        # Accelerations 3 to 5 are those of the rotation of the base, in base axes.
        program.motion(3, np.eye(3), state.rotation.T @ turning, gains.weight_attitude)
        if touching:
            away, drift = plan.position[k] - state.com, moving * plan.velocity[k] - state.com_velocity
            push = moving * plan.acceleration[k] + gains.base[0] * away + gains.base[1] * drift + [0, 0, GRAVITY]
            program.forces(np.tile(np.eye(3), sum(map(len, points.values()))) / machine.mass, push, gains.weight_base)
            self._track_forces(program, points, k, state)
        easing = -gains.rest * state.velocity[6:]
        if machine.limbless:
            posture = gains.posture[0] * (machine.stance[7:] - state.joints) - gains.posture[1] * state.velocity[6:]
            easing[machine.limbless] = posture[machine.limbless]
        program.motion(6, np.eye(n_joints), easing, gains.weight_rest)
        low, high = torque_range(machine.torque_limits, state.velocity[6:], self.speed_limit)
        bias = np.concatenate([state.bias[:6] - self.unknown, state.bias[6:]])
        solution = program.solve(np.hstack(dynamics), bias, low, high)
        if solution is None:
            torque, acceleration = -gains.rest * state.inertia.diagonal()[6:] * state.velocity[6:], np.zeros(n_joints)
            self.last = None
        else:
            torque, acceleration = solution[0], solution[1][6:]
            self.last = state.velocity, solution[1]
        damping = gains.impedance * state.inertia.diagonal()[6:]
        return Command(torque, state.velocity[6:], acceleration, damping, solution is not None)

    def _learn(self, state: State) -> None:
        """Adds a share of what changed the momentum since the last command, beside the commanded accelerations, to the unknown forces."""
        if self.gains.unknown == 0 or self.last is None:
            return
        velocity, acceleration = self.last
        step, weight = self.plan.step, GRAVITY * self.machine.mass
        missing = state.inertia[:6] @ ((state.velocity - velocity) / step - acceleration)
        most = UNKNOWN * weight * np.repeat([1.0, self.plan.position[0, 2]], 3)
        self.unknown = np.clip(self.unknown + step / self.gains.unknown * missing, -most, most)

    def contact_points(self, f: int, k: int, state: State) -> Floats:
        """Points at which a foot in contact transmits forces, world frame, m, shape (points, 3): for a sole the corners of its inner part."""
        sole, center = self.machine.feet[f].sole, state.feet[f]
        if sole is None:
            return (center - self.machine.feet[f].radius * self.plan.normals[k, f])[None]  # type: ignore[no-any-return]
        return center + sole.corners(PRESSED) @ state.soles[f].T  # type: ignore[no-any-return]

    def _turn_sole(self, program: _Program, f: int, k: int, state: State, touching: bool) -> None:
        """Adds the task on the rotation of a sole: at rest in contact, otherwise on the plan."""
        plan, gains = self.plan, self.gains
        jacobian, drift = self.machine.turning(self.machine.feet[f])
        spin = jacobian @ state.velocity
        if touching:
            wanted = -gains.stance * spin
        else:
            rate = plan.yaw_rates[k, f] * plan.normals[k, f]
            wanted = gains.swing[0] * _rotation.between(state.soles[f], plan.sole(k, f)) + gains.swing[1] * (rate - spin)
        program.motion(0, jacobian, wanted - drift, gains.weight_feet if touching else gains.weight_soles)

    def _track_forces(self, program: _Program, points: dict[int, Floats], k: int, state: State) -> None:
        """Adds the tasks on the forces and moments of the feet in contact; a moment counts as a force on half of the sole's diagonal."""
        plan, mass, first = self.plan, self.machine.mass, 0
        n_forces = 3 * sum(map(len, points.values()))
        for f, at in points.items():
            columns = slice(first, first + 3 * len(at))
            first += 3 * len(at)
            task = np.zeros((3, n_forces))
            task[:, columns] = np.tile(np.eye(3), len(at)) / mass
            program.forces(task, plan.forces[k, f] / mass, self.gains.weight_forces)
            sole = self.machine.feet[f].sole
            if sole is not None:
                lever = mass * float(np.hypot(sole.length, sole.width)) / 2
                task[:, columns] = np.hstack(list(_rotation.crosses(at - state.feet[f]))) / lever
                program.forces(task, plan.moments[k, f] / lever, self.gains.weight_forces)

    def _planned(self, f: int, k: int) -> Floats:
        """Planned position of the centre of a foot, world frame, m."""
        return self.plan.feet[k, f] + self.machine.feet[f].radius * self.plan.normals[k, f]  # type: ignore[no-any-return]

    def _touches(self, f: int, k: int, due: bool, state: State, load: float) -> bool:
        """True if a foot is in contact: on the ground in a planned stance, or loaded before its planned touchdown, on the descent."""
        bears = load > self.gains.bears
        if bears:
            self.ground[f] = state.feet[f]
        elif not due:
            self.ground[f] = np.nan
        if due:
            lifted = float((state.feet[f] - self.ground[f]) @ self.plan.normals[k, f])
            return bears or lifted < self.gains.near or (self.gains.mapped and self._gap(f, k, state) < self.gains.near)
        # Against the ground: downhill a foot descends from its lift-off on.
        return bears and float(self.plan.feet_velocity[k, f] @ self.plan.normals[k, f]) < 0

    def _gap(self, f: int, k: int, state: State) -> float:
        """Distance of a foot from the ground of the plan, along the normal, m."""
        x, y, z = state.feet[f]
        return float((z - self.plan.terrain.height(x, y)) * self.plan.normals[k, f, 2]) - self.machine.feet[f].radius

    def _swing(self, f: int, k: int, time: float, state: State) -> tuple[Floats, Floats, Floats]:
        """Reference position, velocity and acceleration of the centre of a foot without contact, world frame."""
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
        """Displacement of a foothold along the ground, m: a share of the error of the capture point, where the base would come to rest."""
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
    """Quadratic program. Unknowns: accelerations, then the forces of the feet in contact."""

    def __init__(self, n_accelerations: int, n_contacts: int) -> None:
        self.n_accelerations, self.size = n_accelerations, n_accelerations + 3 * n_contacts
        self.hessian, self.gradient = TINY * np.eye(self.size), np.zeros(self.size)
        self.cones: list[Floats] = []

    def motion(self, first: int, task: Floats, wanted: Floats, weight: float) -> None:
        """Adds the task ``task x = wanted`` on the unknowns from index ``first``."""
        columns = slice(first, first + task.shape[1])
        self.hessian[columns, columns] += weight * task.T @ task
        self.gradient[columns] -= weight * task.T @ wanted

    def forces(self, task: Floats, wanted: Floats, weight: float) -> None:
        """Adds the task ``task x = wanted`` on the forces."""
        self.motion(self.n_accelerations, task, wanted, weight)

    def friction(self, dynamics: list[Floats], jacobian: Floats, up: Floats, friction: float) -> None:
        """Adds the friction pyramid of the next contact, and the column of its force to the dynamics."""
        across = _rotation.upright(up)
        cone = np.zeros((4, self.size))
        first = self.n_accelerations + 3 * len(self.cones)
        sides = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        cone[:, first : first + 3] = friction * up + sides @ across[:, :2].T
        self.cones.append(cone)
        dynamics.append(-jacobian.T)

    def solve(self, dynamics: Floats, bias: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats] | None:
        """Torques of the joints, shape (joints,), and accelerations of all degrees of freedom, or None without a solution.

        ``dynamics x + bias`` are the generalised forces of the motors; ``low`` and ``high`` are their limits.
        """
        n_cone = 4 * len(self.cones)
        rows = np.vstack([dynamics[:6], *self.cones, dynamics[6:]])
        lower = np.concatenate([-bias[:6], np.zeros(n_cone), low - bias[6:]])
        upper = np.concatenate([-bias[:6], np.full(n_cone, UNBOUNDED), high - bias[6:]])
        kinds = np.repeat([EQUAL, BOUND, SOFT], [6, n_cone, len(low)]).astype(np.int32)
        x, _, flag, _ = daqp.solve(self.hessian, self.gradient, rows, np.minimum(upper, UNBOUNDED), np.maximum(lower, -UNBOUNDED), kinds)
        if flag < 1 or not np.all(np.isfinite(x)):
            return None
        torque: Floats = np.clip((dynamics @ x + bias)[6:], low, high)
        return torque, x[: self.n_accelerations]
