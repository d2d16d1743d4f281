"""Simulation of a robot that is driven by commands, with gaits that are chosen online."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from typing import Any, Optional, Sequence

import numpy as np

from .. import Error, Planner, Robot, RobotState, Terrain, Update
from .. import Plan as Planned
from . import _ground, _plan, _rotation, _video
from ._controller import ON_SOLES, Controller, Gains
from ._engine import Floats
from ._model import Machine, Path, State
from ._play import LOADED, LOW, STEP, STEPS, Observer, Simulation, assign_feet, check, start_pose, window
from ._report import DriveReport
from ._robot import robot as robot_of

#: Control period, s.
PERIOD = STEP * STEPS
#: Time after a change of the command or a push for which the velocity error does not count, s.
SETTLING = 1.0
#: Time over which velocities are averaged before they are compared with the command, s.
AVERAGED = 0.4
#: Gains by default: the planner chooses footholds, and loads and steps are not known.
GAINS = Gains(capture=0.0, unknown=0.3, seek=0.3, mapped=False)
#: Standard deviations of the noise on the planner's state: positions, m; velocities, m/s; attitude, rad; angular velocity, rad/s.
NOISE = (0.005, 0.05, 0.01, 0.05)
#: Largest delay of the planner, s.
LONGEST_DELAY = 0.5
#: Difference between the masses of the planner's robot and of the model from which it is noted, as a share of the model's mass.
MASS_APART = 0.001
#: Largest speeds of random commands: forward and sideways, as shares of sqrt(g l), and yaw rate, rad/s; times between changes, s.
RANDOM_SPEEDS, RANDOM_TIMES = (0.3, 0.15, 0.6), (2.0, 5.0)
#: Largest impulse of random pushes, N s per kg; their duration and the times between them, s.
RANDOM_IMPULSE, RANDOM_PUSH, RANDOM_WAITS = 0.35, 0.1, (3.0, 6.0)
#: Distance around the start that uneven ground covers, in addition to what the commands reach, m.
AROUND = 2.0

#: Command: velocity forward and to the left, m/s, yaw rate, rad/s, and its duration, s.
Command = tuple[tuple[float, float, float], float]
#: Push: time, s, force on the base in the world frame, N, and its duration, s.
Push = tuple[float, tuple[float, float, float], float]
#: Mass on the base, kg, and its place in front and to the left of the centre of mass, m.
Load = tuple[float, tuple[float, float]]


def drive(
    model: Path,
    commands: Sequence[Command],
    *,
    pushes: Sequence[Push] = (),
    feet: Optional[Sequence[str]] = None,
    robot: Optional[Robot] = None,
    terrain: Optional[Terrain] = None,
    ground: Optional[Terrain] = None,
    friction: Optional[float] = None,
    patches: Sequence[_ground.Patch] = (),
    load: Optional[Load] = None,
    seed: Optional[int] = None,
    rate: float = 50.0,
    open_loop: bool = False,
    delay: float = 0.0,
    noise: bool = False,
    settings: Optional[dict[str, Any]] = None,
    speed_limit: float = 30.0,
    gains: Optional[Gains] = None,
    video: Optional[Path] = None,
    viewer: bool = False,
) -> DriveReport:
    """Drives a robot in MuJoCo: gaits are planned online, and a whole-body controller follows the plan in force.

    Parameters
    ----------
    model : path
        MuJoCo model with a free base and legs, all of whose joints have motors, or URDF file, which gets both.
    commands : list of ((float, float, float), float)
        Velocity forward and to the left, m/s, and yaw rate, rad/s, each with its duration, s.
    pushes : list of (float, (float, float, float), float)
        Time, s, force on the base in the world frame, N, and duration, s.
    feet : list of str, optional
        Geoms, bodies or sites that are the feet. Default: the feet on which the model stands.
    robot : Robot, optional
        Robot of the planner. Without ``feet``, each of its feet is assigned to the nearest foot of the model. Default: made from the model by
        ``cregopt.mujoco.robot``.
    terrain : Terrain, optional
        Terrain that planner and controller know. Default: flat.
    ground : Terrain, optional
        Terrain of the simulation. Default: ``terrain``.
    friction : float, optional
        Friction coefficient of the simulation, which the controller knows. Default: that of ``terrain``, which the planner always assumes.
    patches : list of (float, float, float), optional
        Friction coefficient of a part of the ground of the simulation, which neither planner nor controller knows, and the range of x that it covers,
        m. Patches do not overlap.
    load : (float, (float, float)), optional
        Mass on the base, kg, which neither planner nor controller knows, and its place in front and to the left of the centre of mass, m.
    seed : int, optional
        Seed of disturbances of start, masses and friction as in ``play``, and of the noise. Default: no disturbances, and noise of seed 0.
    rate : float, default 50
        Updates of the plan per second of the simulation.
    open_loop : bool, default False
        The planner continues from its own plan instead of the measured state: nothing reacts to what happens but the controller.
    delay : float, default 0
        Age of the planner's state when its plan comes into force, s, at most 0.5. The planner knows it.
    noise : bool, default False
        Adds noise to the planner's state of base and feet: 5 mm, 0.05 m/s, 0.01 rad and 0.05 rad/s. The contacts and the controller's state stay
        exact.
    settings : dict, optional
        Settings of ``cregopt.Planner``, except for ``latency``, which is the delay.
    gains : Gains, optional
        Gains and weights of the controller. Default: those of ``play`` without the displacement of footholds, which the planner chooses, and with
        ``unknown`` of 0.3 s and ``seek`` of 0.3 m/s; on soles with a ``weight_attitude`` of 0.3.
    speed_limit, video, viewer
        As in ``play``.

    Returns
    -------
    DriveReport
        Falls, tracking errors, times of the updates, gaits over time and motor loads.

    Raises
    ------
    Error
        If the model or a value is invalid, or the robot cannot be planned for.
    ImportError
        If MuJoCo or DAQP is not installed.
    """
    for number, (command, seconds) in enumerate(commands):
        if not (np.all(np.isfinite([*command, seconds])) and seconds > 0):
            raise Error(f"commands[{number}]: {(command, seconds)!r}, but it must be three velocities and a positive duration, s")
    if not commands:
        raise Error("commands: there must be at least one")
    for number, (time, force, seconds) in enumerate(pushes):
        if not (np.all(np.isfinite([time, *force, seconds])) and seconds > 0):
            raise Error(f"pushes[{number}]: {(time, force, seconds)!r}, but it must be a time, s, a force, N, and a positive duration, s")
    if not (np.isfinite(rate) and 1 <= rate <= 1 / PERIOD):
        raise Error(f"rate {rate!r}: must be between 1 and {1 / PERIOD:g} Hz")
    if not (np.isfinite(delay) and 0 <= delay <= LONGEST_DELAY):
        raise Error(f"delay {delay!r}: must be between 0 and {LONGEST_DELAY:g} s")
    if settings and "latency" in settings:
        raise Error("settings: the latency is given by the delay")
    check(speed_limit, friction, seed, video, viewer)
    _check_hidden(patches, load)
    machine = Machine(model, feet)
    robot = robot or robot_of(model, feet)
    if robot.feet != len(machine.feet):
        raise Error(f"the robot has {robot.feet} feet, the model {machine.name} {len(machine.feet)}: name them (--feet)")
    if feet is None:
        assign_feet(machine, robot.nominal_feet)
    terrain = terrain or Terrain("flat")
    report = DriveReport(
        model=machine.name,
        mass=machine.mass,
        friction=terrain.friction if friction is None else friction,
        seed=seed,
        seconds=float(sum(seconds for _, seconds in commands)),
        commands=[[*command, seconds] for command, seconds in commands],
        pushes=[[time, *force, seconds] for time, force, seconds in pushes],
        patches=[[*patch] for patch in patches],
        load=None if load is None else [load[0], *load[1]],
        joint_speed_limit=speed_limit,
        rate=rate,
        delay=delay,
        noise=noise,
        open_loop=open_loop,
    )
    if abs(robot.mass - machine.mass) > MASS_APART * machine.mass:
        report.notes.append(f"the planner's robot weighs {robot.mass:.4g} kg, the model {machine.mass:.4g} kg")
    planner = Planner(robot, terrain, {**(settings or {}), "latency": delay})
    gains = gains or (replace(GAINS, weight_attitude=ON_SOLES.weight_attitude) if machine.soled else GAINS)
    simulation = _Online(machine, planner, robot, terrain, ground or terrain, gains, commands, pushes, patches, load, report)
    with ExitStack() as stack:
        observers: list[Observer] = []
        if video is not None:
            distance = 5 * float(simulation.plan.position[0, 2])
            observers.append(stack.enter_context(_video.Film(video, simulation.model, machine.base, distance, 1 / PERIOD)))
        if viewer:
            observers.append(window(stack, simulation))
        simulation.run(observers)
    return report


def _check_hidden(patches: Sequence[_ground.Patch], load: Optional[Load]) -> None:
    """Checks what planner and controller do not know. Raises Error for the first bad value."""
    before = -np.inf
    for number, (friction, start, end) in sorted(enumerate(patches), key=lambda patch: patch[1][1]):
        if not (np.all(np.isfinite([friction, start, end])) and friction > 0 and start < end):
            raise Error(f"patches[{number}]: {(friction, start, end)!r}, but it must be a positive friction coefficient and a range of x, m")
        if start < before:
            raise Error(f"patches[{number}]: it begins at {start:g} m, but another patch ends at {before:g} m")
        before = end
    if load is not None and not (np.all(np.isfinite([load[0], *load[1]])) and load[0] > 0):
        raise Error(f"load {load!r}: must be a positive mass, kg, and a place, m")


def random_drive(seconds: float, seed: int, mass: float, height: float) -> tuple[list[Command], list[Push]]:
    """Random commands and pushes for at least ``seconds``, for a robot of a mass, kg, and a base height, m."""
    if not (np.isfinite(seconds) and seconds > 0):
        raise Error(f"random commands for {seconds!r} s: must be positive")
    if seed < 0:
        raise Error(f"seed {seed!r}: must not be negative")
    random = np.random.default_rng(seed)
    speed = float(np.sqrt(9.80665 * height))
    limits = np.array([RANDOM_SPEEDS[0] * speed, RANDOM_SPEEDS[1] * speed, RANDOM_SPEEDS[2]])
    commands: list[Command] = [((0.0, 0.0, 0.0), 0.5)]
    while sum(time for _, time in commands) < seconds:
        forward, left, turn = random.uniform([-0.3, -1, -1], 1) * limits
        command = (0.0, 0.0, 0.0) if random.uniform() < 0.15 else (float(forward), float(left), float(turn))
        commands.append((command, float(random.uniform(*RANDOM_TIMES))))
    pushes: list[Push] = []
    time = 2.0
    while time < seconds - 1:
        angle, force = random.uniform(0, 2 * np.pi), random.uniform(0.3, 1) * RANDOM_IMPULSE * mass / RANDOM_PUSH
        pushes.append((time, (float(force * np.cos(angle)), float(force * np.sin(angle)), 0.0), RANDOM_PUSH))
        time += float(random.uniform(*RANDOM_WAITS))
    return commands, pushes


class _Online(Simulation[DriveReport]):
    """Simulation of a robot whose plan changes."""

    def __init__(
        self,
        machine: Machine,
        planner: Planner,
        robot: Robot,
        terrain: Terrain,
        ground: Terrain,
        gains: Gains,
        commands: Sequence[Command],
        pushes: Sequence[Push],
        patches: Sequence[_ground.Patch],
        load: Optional[Load],
        report: DriveReport,
    ) -> None:
        self.planner, self.robot, self.terrain = planner, robot, terrain
        self.commands, self.pushes = commands, pushes
        #: Times at which the commands end, s.
        self.ends = np.cumsum([seconds for _, seconds in commands])
        self.height = float(robot.to_dict()["base_height"])
        self.radii = np.array([foot.radius for foot in machine.feet])
        #: Updates whose plans are not yet in force, each with the time at which it comes into force, s.
        self.pending: list[tuple[float, Update]] = []
        #: Durations of the updates, s.
        self.times: list[float] = []
        first = planner.update(self._standing(), commands[0][0], 0.0).plan
        #: Time at which the plan in force starts, s.
        self.start = first.start
        plan = self._reference(first)
        controller = Controller(machine, plan, report.friction, report.joint_speed_limit, gains)
        pose = start_pose(machine, plan)
        if load is not None:
            mass, (forward, left) = load
            machine.add_load(mass, plan.rotation[0].T @ (plan.position[0] - pose[:3]) + [forward, left, 0])
        # The planner may not know the ground: the robot starts above it.
        pose[2] += max(ground.height(x, y) - terrain.height(x, y) for x, y, _ in plan.feet[0])
        reach = AROUND + sum(float(np.hypot(*command[:2])) * seconds for command, seconds in commands)
        corners = np.array([[[x, y, ground.height(0, 0)]] for x in (-reach, reach) for y in (-reach, reach)])
        super().__init__(controller, pose, report, ground, corners, patches)
        # Other numbers than those of the disturbances.
        self.random = np.random.default_rng([report.seed or 0, 1])

    def _standing(self) -> RobotState:
        """State of the planner's robot that stands still at the origin, on the terrain that the planner knows."""
        feet = self.robot.nominal_feet.copy()
        feet[:, 2] = [self.terrain.height(x, y) for x, y, _ in feet]
        base = [0, 0, self.height + self.terrain.height(0, 0)]
        return RobotState(base, np.eye(3), np.zeros(3), np.zeros(3), feet, 0 * feet, [True] * len(feet))

    def _reference(self, plan: Planned) -> _plan.Plan:
        """Plan for the controller."""
        return _plan.of_samples(plan.sample(1 / PERIOD), self.robot, plan.terrain, plan.schedule, plan.horizon, 1 / PERIOD)

    def run(self, observers: Sequence[Observer]) -> None:
        """Simulates all commands, or until the robot falls."""
        report, d = self.report, self.data
        speeds: list[Floats] = []
        saturated = 0
        next_update = 0.0
        for number in range(max(1, round(report.seconds / PERIOD))):
            time = number * PERIOD
            if not np.all(np.isfinite(d.qpos)):
                report.upright, report.fall_time, report.fall = False, time, "the simulation diverged"
                break
            state = self.machine.state(d.qpos, d.qvel)
            loads, trunk_touches = self._contacts()
            report.fall = self._fall(state, trunk_touches)
            if report.fall:
                report.upright, report.fall_time = False, time
                break
            current = int(np.searchsorted(self.ends, time + 1e-9, side="right"))
            command = self.commands[min(current, len(self.commands) - 1)][0]
            speeds.append(_speeds(state, command))
            if time >= next_update - 1e-9:
                next_update += 1 / report.rate
                self._plan_again(self._planned(time) if report.open_loop else self._measured(time, state, loads), command, time)
            while self.pending and self.pending[0][0] <= time + 1e-9:
                self._take(self.pending.pop(0)[1], time)
            self._push(time)
            saturated += self._drive(time - self.start, state, loads)
            for observer in observers:
                observer(self.model, d)
        report.torque_saturated = saturated / max(len(speeds), 1)
        # The last state: standing, or lying after a fall.
        report.distance = float(np.linalg.norm(state.com[:2]))
        self._summarise(np.array(speeds))

    def _plan_again(self, state: RobotState, command: tuple[float, float, float], time: float) -> None:
        """Updates the plan; it comes into force after the delay. If the planner does not accept the state, the plan before stays."""
        report = self.report
        report.updates += 1
        try:
            update = self.planner.update(state, command, time)
        except Error as error:
            report.notes.append(f"no plan at {time:.2f} s: {error}")
            report.kept += 1
            return
        self.times.append(update.seconds)
        report.kept += not update.renewed
        report.stretched += update.stretched
        self.pending.append((time + report.delay, update))

    def _take(self, update: Update, time: float) -> None:
        """Puts the plan of an update into force."""
        if update.renewed:
            self.start, self.plan = update.plan.start, self._reference(update.plan)
            self.controller.follow(self.plan)
        gait, gaits = update.plan.gait or "stand", self.report.gaits
        if not gaits or gaits[-1][1] != gait:
            gaits.append([round(time, 3), gait])

    def _planned(self, time: float) -> RobotState:
        """State that the plan in force has at a time, s."""
        plan, k = self.plan, self.plan.index(time - self.start)
        base = plan.position[k], plan.rotation[k], plan.velocity[k], plan.angular_velocity[k]
        return RobotState(*base, plan.feet[k], plan.feet_velocity[k], plan.stands(k), plan.yaws[k])

    def _measured(self, time: float, state: State, loads: Floats) -> RobotState:
        """State of the robot, with noise if there is any."""
        machine = self.machine
        # Contact points as the controller has them. Their velocities are those of the centres: a rolling foot moves its contact point along.
        feet = state.feet - self.radii[:, None] * self.plan.normals[self.plan.index(time - self.start)]
        speeds = np.array([machine.jacobian(foot, center)[0] @ state.velocity for foot, center in zip(machine.feet, state.feet)])
        position, velocity, rotation, spin = state.com, state.com_velocity, state.rotation, state.angular_velocity
        if self.report.noise:
            of = self.random.normal
            position, velocity, spin = position + of(0, NOISE[0], 3), velocity + of(0, NOISE[1], 3), spin + of(0, NOISE[3], 3)
            rotation = _rotation.of_vector(of(0, NOISE[2], 3)) @ rotation
            feet, speeds = feet + of(0, NOISE[0], feet.shape), speeds + of(0, NOISE[1], speeds.shape)
        contacts = loads > LOADED * machine.mass * 9.80665 / len(loads)
        yaws = np.arctan2(state.soles[:, 1, 0], state.soles[:, 0, 0])
        return RobotState(position, rotation, velocity, spin, feet, speeds, contacts, yaws)

    def _push(self, time: float) -> None:
        """Applies the pushes of a time."""
        force = np.zeros(3)
        for start, push, seconds in self.pushes:
            if start <= time < start + seconds:
                force += push
        self.data.xfrc_applied[self.machine.base, :3] = force

    def _fall(self, state: State, trunk_touches: bool) -> Optional[str]:
        """Description of the fall, or None if the robot has not fallen."""
        toppled = self._toppled(state, trunk_touches)
        if toppled is None and state.com[2] - float(state.feet[:, 2].min()) < LOW * self.height:
            return "the base is too low"
        return toppled

    def _summarise(self, speeds: Floats) -> None:
        """Reports durations of the updates, and velocity errors. ``speeds``: actual and commanded velocities per control period, shape (n, 6)."""
        report = self.report
        if self.times:
            report.ms_median, report.ms_99 = (1e3 * float(np.percentile(self.times, part)) for part in (50, 99))
            report.late = int(np.sum(np.array(self.times) > 1 / report.rate))
        width = round(AVERAGED / PERIOD)
        if len(speeds) <= width:
            return
        mean = np.apply_along_axis(lambda v: np.convolve(v, np.ones(width) / width, mode="valid"), 0, speeds)
        # Ends of the averaged times. They do not count from the begin of a change until the settling after its end.
        at = (np.arange(len(mean)) + width) * PERIOD
        changes = [(0.0, 0.0), *((end, end) for end in self.ends[:-1]), *((time, time + seconds) for time, _, seconds in self.pushes)]
        settled = np.ones(len(at), dtype=bool)
        for begin, end in changes:
            settled &= (at < begin) | (at >= end + SETTLING + AVERAGED)
        error = (mean[:, :3] - mean[:, 3:])[settled]
        if len(error):
            report.speed_error_rms = float(np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))))
            report.turn_error_rms = float(np.sqrt(np.mean(error[:, 2] ** 2)))
            report.speed_command_rms = float(np.sqrt(np.mean(np.sum(mean[settled][:, 3:5] ** 2, axis=1))))


def _speeds(state: State, command: tuple[float, float, float]) -> Floats:
    """Velocity forward and to the left, m/s, and yaw rate, rad/s: those of the robot, then those of the command, shape (6,)."""
    yaw = float(np.arctan2(state.rotation[1, 0], state.rotation[0, 0]))
    x, y = state.com_velocity[:2]
    forward, left = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
    return np.array([forward, left, state.angular_velocity[2], *command])
