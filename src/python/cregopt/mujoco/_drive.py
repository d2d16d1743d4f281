"""Simulation of a robot that is driven by commands, with gaits that are chosen online."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, Optional, Sequence

import numpy as np

from .. import Error, Planner, Robot, RobotState, Terrain, Update
from . import _plan, _rotation, _video
from ._controller import Controller, Gains
from ._engine import Floats, mj
from ._model import Machine, Path, State
from ._play import LOADED, LEAN, LOW, STEP, STEPS, Observer, Simulation, start_pose, window
from ._report import DriveReport
from ._robot import robot as robot_of

#: Time after a change of the command or a push for which the velocity error does not count, s.
SETTLING = 1.0
#: Time over which velocities are averaged before they are compared with the command, s.
AVERAGED = 0.4
#: Standard deviations of the noise on the planner's state: positions, m; velocities, m/s; attitude, rad; angular velocity, rad/s.
NOISE = (0.005, 0.05, 0.01, 0.05)
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
        MuJoCo model (MJCF or URDF) with a free base and legs, all of whose joints have motors.
    commands : list of ((float, float, float), float)
        Velocity forward and to the left, m/s, and yaw rate, rad/s, each with its duration, s.
    pushes : list of (float, (float, float, float), float)
        Time, s, force on the base in the world frame, N, and duration, s.
    feet : list of str, optional
        Geoms, bodies or sites that are the feet. Default: the feet on which the model stands.
    robot : Robot, optional
        Robot of the planner. Default: made from the model by ``cregopt.mujoco.robot``.
    terrain : Terrain, optional
        Terrain that planner and controller know. Default: flat.
    ground : Terrain, optional
        Terrain of the simulation. Default: ``terrain``.
    friction : float, optional
        Friction coefficient of the simulation. Default: that of ``terrain``, which the controller assumes.
    seed : int, optional
        Seed of disturbances of start, masses and friction as in ``play``, and of the noise. Default: no disturbances.
    rate : float, default 50
        Updates of the plan per second of the simulation.
    open_loop : bool, default False
        The planner continues from its own plan instead of the measured state: nothing reacts to what happens but the controller.
    delay : float, default 0
        Age of the planner's state when its plan comes into force, s. The planner knows it.
    noise : bool, default False
        Adds noise to the planner's state: 5 mm, 0.05 m/s, 0.01 rad and 0.05 rad/s. The controller's state stays exact.
    settings : dict, optional
        Settings of ``cregopt.Planner``.
    speed_limit, gains, video, viewer
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
    if not commands or not all(np.isfinite(time) and time > 0 for _, time in commands):
        raise Error("commands: at least one, each with a positive duration, s")
    if not (np.isfinite(rate) and 1 <= rate <= 1 / (STEP * STEPS)):
        raise Error(f"rate {rate!r}: must be between 1 and {1 / (STEP * STEPS):g} Hz")
    if not (np.isfinite(delay) and 0 <= delay <= 0.5):
        raise Error(f"delay {delay!r}: must be between 0 and 0.5 s")
    if video is not None:
        _video.prepare(video)
    if viewer and _video.headless():
        raise Error("no window can be opened: there is no display")
    machine = Machine(model, feet)
    robot = robot or robot_of(model, feet)
    if robot.feet != len(machine.feet):
        raise Error(f"the robot has {robot.feet} feet, the model {machine.name} {len(machine.feet)}: name them (--feet)")
    terrain = terrain or Terrain("flat")
    planner = Planner(robot, terrain, {**(settings or {}), "latency": delay})
    simulation = _Online(machine, planner, robot, terrain, ground or terrain, gains or Gains(capture=0.0), commands, pushes, speed_limit, friction, seed)
    simulation.online(1 / rate, open_loop, delay, noise)
    with ExitStack() as stack:
        observers: list[Observer] = []
        if video is not None:
            height = 5 * float(simulation.plan.position[0, 2])
            observers.append(stack.enter_context(_video.Film(video, simulation.model, machine.base, height, 1 / simulation.plan.step)))
        if viewer:
            observers.append(window(stack, simulation))
        simulation.run(observers)
    return simulation.report


def random_drive(seconds: float, seed: int, mass: float, height: float) -> tuple[list[Command], list[Push]]:
    """Random commands and pushes for a robot of a mass, kg, and a base height, m."""
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
        speed_limit: float,
        friction: Optional[float],
        seed: Optional[int],
    ) -> None:
        self.planner, self.robot, self.terrain = planner, robot, terrain
        self.height = float(robot.to_dict()["base_height"])
        self.commands, self.pushes = commands, pushes
        self.ends = np.cumsum([time for _, time in commands])
        standing = robot.nominal_feet + [0, 0, self.height]
        standing[:, 2] = [terrain.height(x, y) for x, y, _ in standing]
        nominal = RobotState([0, 0, self.height + terrain.height(0, 0)], np.eye(3), np.zeros(3), np.zeros(3), standing, 0 * standing, [True] * len(standing))
        self.update = planner.update(nominal, commands[0][0], 0.0)
        plan = self._reference(self.update)
        friction = terrain.friction if friction is None else friction
        controller = Controller(machine, plan, friction, speed_limit, gains)
        report = DriveReport(
            model=machine.name,
            mass=machine.mass,
            friction=friction,
            seed=seed,
            seconds=float(self.ends[-1]),
            commands=[[*command, time] for command, time in commands],
            pushes=[[time, *force, length] for time, force, length in pushes],
            joint_speed_limit=speed_limit,
        )
        reach = AROUND + sum(float(np.hypot(*command[:2])) * time for command, time in commands)
        corners = np.array([[[x, y, ground.height(0, 0)]] for x in (-reach, reach) for y in (-reach, reach)])
        super().__init__(controller, start_pose(machine, plan), report, ground, corners if ground.to_dict()["shape"] != "flat" else plan.feet)
        self.random = np.random.default_rng(seed)

    def online(self, period: float, open_loop: bool, delay: float, noise: bool) -> None:
        """Sets how the planner is called."""
        self.period, self.open_loop, self.delay, self.noise = period, open_loop, delay, noise
        self.report.rate, self.report.delay, self.report.noise, self.report.open_loop = 1 / period, delay, noise, open_loop

    def _reference(self, update: Update) -> _plan.Plan:
        plan = update.plan
        return _plan.of_samples(plan.sample(1 / (STEP * STEPS)), self.robot, self.terrain, plan.schedule, plan.horizon, 1 / (STEP * STEPS))

    def run(self, observers: Sequence[Observer]) -> None:
        """Simulates all commands, or until the robot falls."""
        report, d = self.report, self.data
        step = STEP * STEPS
        times: list[float] = []
        speeds: list[Floats] = []
        saturated = 0
        next_update = 0.0
        pending: list[tuple[float, Update]] = []
        periods = round(report.seconds / step)
        for number in range(periods):
            time = number * step
            if not np.all(np.isfinite(d.qpos)):
                report.upright, report.fall_time, report.fall = False, time, "the simulation diverged"
                break
            state = self.machine.state(d.qpos, d.qvel)
            loads, trunk_touches = self._contacts()
            report.fall = self._fallen(state, trunk_touches)
            if report.fall:
                report.upright, report.fall_time = False, time
                break
            command = self.commands[int(np.searchsorted(self.ends, time + 1e-9, side="right").clip(max=len(self.commands) - 1))][0]
            yaw = float(np.arctan2(state.rotation[1, 0], state.rotation[0, 0]))
            forward = np.array([np.cos(yaw), np.sin(yaw)])
            left = np.array([-forward[1], forward[0]])
            speeds.append(np.array([*(axis @ state.com_velocity[:2] for axis in (forward, left)), state.angular_velocity[2], *command]))
            if time >= next_update - 1e-9:
                next_update += self.period
                try:
                    update = self.planner.update(self._measured(time, state, loads), command, time)
                except Error as error:
                    report.notes.append(f"no plan at {time:.2f} s: {error}")
                    report.kept += 1
                else:
                    times.append(update.seconds)
                    pending.append((time + self.delay, update))
            while pending and pending[0][0] <= time + 1e-9:
                self._take(pending.pop(0)[1], time)
            self._push(time)
            saturated += self._drive(time - self.update.plan.start, state, loads)
            for observer in observers:
                observer(self.model, d)
        report.torque_saturated = saturated / max(len(speeds), 1)
        report.distance = float(np.linalg.norm(self.machine.state(d.qpos, d.qvel).com[:2])) if np.all(np.isfinite(d.qpos)) else 0.0
        self._summarise(np.array(times), np.array(speeds))

    def _take(self, update: Update, time: float) -> None:
        """Puts a plan into force."""
        report = self.report
        report.kept += not update.renewed
        if update.renewed:
            self.update = update
            self.plan = self._reference(update)
            self.controller.follow(self.plan)
        gait = update.plan.gait or "stand"
        if not report.gaits or report.gaits[-1][1] != gait:
            report.gaits.append([round(time, 3), gait])

    def _measured(self, time: float, state: State, loads: Floats) -> RobotState:
        """State as the planner gets it."""
        machine = self.machine
        if self.open_loop:
            k = self.plan.index(time - self.update.plan.start)
            plan = self.plan
            contacts = plan.stands(k).tolist()
            return RobotState(plan.position[k], plan.rotation[k], plan.velocity[k], plan.angular_velocity[k], plan.feet[k], plan.feet_velocity[k], contacts)
        points = state.feet - [[0, 0, foot.radius] for foot in machine.feet]
        speeds = np.array([machine.jacobian(foot, center)[0] @ state.velocity for foot, center in zip(machine.feet, state.feet)])
        position, velocity, rotation, spin = state.com, state.com_velocity, state.rotation, state.angular_velocity
        if self.noise:
            of = self.random.normal
            position, velocity, spin = position + of(0, NOISE[0], 3), velocity + of(0, NOISE[1], 3), spin + of(0, NOISE[3], 3)
            rotation = _rotation.of_vector(of(0, NOISE[2], 3)) @ rotation
            points, speeds = points + of(0, NOISE[0], points.shape), speeds + of(0, NOISE[1], speeds.shape)
        contacts = (loads > LOADED * machine.mass * 9.80665 / len(loads)).tolist()
        return RobotState(position, rotation, velocity, spin, points, speeds, contacts)

    def _push(self, time: float) -> None:
        """Applies the pushes of a time."""
        force = np.zeros(3)
        for start, push, length in self.pushes:
            if start <= time < start + length:
                force += push
        self.data.xfrc_applied[self.machine.base, :3] = force

    def _fallen(self, state: State, trunk_touches: bool) -> Optional[str]:
        """Description of the fall, or None if the robot has not fallen."""
        lean = float(np.arccos(np.clip(state.rotation[2, 2], -1, 1)))
        if trunk_touches:
            return "the trunk touches the ground"
        if lean > LEAN:
            return f"it leans by {np.degrees(lean):.0f} deg"
        if state.com[2] - float(state.feet[:, 2].min()) < LOW * self.height:
            return "the base is too low"
        return None

    def _summarise(self, times: Floats, speeds: Floats) -> None:
        """Velocity errors and times of the updates."""
        report = self.report
        if len(times):
            report.updates = len(times)
            report.ms_median, report.ms_99 = (1e3 * float(np.percentile(times, part)) for part in (50, 99))
            report.late = int(np.sum(times > self.period))
        step = STEP * STEPS
        width = round(AVERAGED / step)
        if len(speeds) <= width:
            return
        mean = np.apply_along_axis(lambda v: np.convolve(v, np.ones(width) / width, mode="valid"), 0, speeds)
        at = (np.arange(len(mean)) + width) * step
        begun = np.concatenate([[0.0], self.ends[:-1], [time for time, _, _ in self.pushes]])
        settled = np.all(at[:, None] - begun >= SETTLING + AVERAGED, axis=1, where=at[:, None] >= begun)
        error = (mean[:, :3] - mean[:, 3:])[settled]
        if len(error):
            report.speed_error_rms = float(np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))))
            report.turn_error_rms = float(np.sqrt(np.mean(error[:, 2] ** 2)))
            report.speed_command_rms = float(np.sqrt(np.mean(np.sum(mean[settled][:, 3:5] ** 2, axis=1))))
