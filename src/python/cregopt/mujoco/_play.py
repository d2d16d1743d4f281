"""Plays a plan on a robot."""

from __future__ import annotations

import importlib
import time as clock
from contextlib import ExitStack
from typing import Any, Callable, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .. import Error
from . import _ground, _plan, _rotation, _video
from ._controller import Controller, Gains, torque_range
from ._engine import Floats, mj
from ._model import Machine, Path, State
from ._report import Report

#: Time between steps of the simulation, s, and steps in a period of control.
STEP, STEPS = 0.001, 2
#: Time between what a window shows, s.
FRAME = 0.02
#: Standing before and behind the plan, s.
HOLD = 0.4
#: The masses of plan and model differ by so much of the model's at most.
MASS_APART = 0.05
#: Legs must come so near to the feet of the plan's start, m.
START_MISSED = 0.01
#: A robot has fallen when it leans by more, rad, when its base is lower than this share of the planned height, or further off than so many m.
LEAN, LOW, ASTRAY = float(np.radians(60.0)), 0.5, 1.0
#: A foot is loaded by so much of its share of the weight.
LOADED = 0.05
#: What a seed disturbs: friction and mass by these shares, joints by so many rad, velocities by so many m/s and rad/s.
FRICTION_SPREAD, MASS_SPREAD, JOINT_SPREAD, SPEED_SPREAD = 0.1, 0.03, 0.01, 0.05
#: A motor is at its limit from this share of it on.
SATURATED = 0.99

#: Is called in every period of control with model and data.
Observer = Callable[[Any, Any], None]


def play(
    trajectory: _plan.Motion,
    model: Path,
    *,
    feet: Optional[Sequence[str]] = None,
    friction: Optional[float] = None,
    seed: Optional[int] = None,
    speed_limit: float = 30.0,
    gains: Optional[Gains] = None,
    video: Optional[Path] = None,
    viewer: bool = False,
) -> Report:
    """Plays a plan on a robot in MuJoCo, under a whole-body controller that keeps the motors' limits.

    Parameters
    ----------
    trajectory : Trajectory, Gait, dict or path
        The plan. Its base frame is the centre of mass with the axes of the model's first body.
    model : path
        MuJoCo model (MJCF or URDF) with a free base on legs whose joints all have motors. Geometry of its world is left out: the ground is
        the plan's.
    feet : list of str, optional
        Geoms (balls or capsules), bodies or sites that are the feet, in the plan's order; else those on which the model stands, each the
        plan's foot that is nearest to it.
    friction : float, optional
        Friction coefficient of the ground instead of the plan's. The controller knows it.
    seed : int, optional
        Disturbs, unknown to the controller, friction (by up to 10 %), the masses of all bodies (3 %), joints (0.01 rad) and velocities of the base
        (0.05 m/s and rad/s) at the start.
    speed_limit : float, default 30
        Largest joint speed of the motors, rad/s, at which their torque is gone; it fades from two thirds of that on. Models do not say it.
    gains : Gains, optional
        Of the controller.
    video : path, optional
        File for an animation: .gif, .png (APNG) or .webp.
    viewer : bool, default False
        Show it in a window, in real time.

    Returns
    -------
    Report

    Raises
    ------
    Error
        For a plan or a model that cannot be read, and a plan that is for another robot: other feet, a mass more than 5 % apart, or legs that cannot
        stand as it begins.
    ImportError
        Without MuJoCo.
    """
    if not (np.isfinite(speed_limit) and speed_limit > 0):
        raise Error(f"speed limit {speed_limit!r}: must be positive, rad/s")
    if friction is not None and not (np.isfinite(friction) and friction > 0):
        raise Error(f"friction {friction!r}: must be positive")
    if video is not None:
        _video.prepare(video)
    if viewer and _video.headless():
        raise Error("no window can be opened: there is no display")
    plan = _plan.read(trajectory, 1 / (STEP * STEPS))
    machine = Machine(model, feet, plan.n_feet)
    if abs(machine.mass - plan.robot.mass) > MASS_APART * machine.mass:
        raise Error(
            f"the plan is for a robot of {plan.robot.mass:.4g} kg, the model {machine.name} weighs {machine.mass:.4g} kg, more than "
            f"{100 * MASS_APART:g} % apart; cregopt.mujoco.robot makes a robot of a model"
        )
    if feet is None:
        order = _plan.order_of_feet(plan.robot.nominal_feet, machine.nominal_feet())
        machine.feet = [machine.feet[of] for of in order]
    start = _start(machine, plan)
    friction = plan.terrain.friction if friction is None else friction
    report = Report(
        model=machine.name,
        mass=machine.mass,
        planned_mass=plan.robot.mass,
        friction=friction,
        planned_friction=plan.terrain.friction,
        seed=seed,
        horizon=plan.horizon,
        joint_speed_limit=speed_limit,
    )
    if not np.all(np.isfinite(machine.torque_limits)):
        report.notes.append("the model limits no torque of some joints")
    controller = Controller(machine, plan, friction, speed_limit, gains or Gains())
    simulation = _Simulation(controller, start, report)
    with ExitStack() as stack:
        observers: list[Observer] = []
        if video is not None:
            observers.append(stack.enter_context(_video.Film(video, simulation.model, machine.base, 5 * float(plan.position[0, 2]), 1 / plan.step)))
        if viewer:
            observers.append(_window(stack, simulation))
        simulation.run(observers)
    return report


def _start(machine: Machine, plan: _plan.Plan) -> Floats:
    """The pose at which the plan begins."""
    balls = plan.feet[0] + [[foot.radius] for foot in machine.feet] * plan.normals[0]
    missed, pose = machine.inverse_kinematics(plan.position[0], plan.rotation[0], balls)
    if missed > START_MISSED:
        raise Error(
            f"the legs of the model {machine.name} cannot stand as the plan begins: they miss it by {missed:.3f} m; "
            "cregopt.mujoco.robot makes a robot of a model"
        )
    return pose


def _window(stack: ExitStack, simulation: _Simulation) -> Observer:
    """Shows a simulation in real time."""
    window = stack.enter_context(importlib.import_module("mujoco.viewer").launch_passive(simulation.model, simulation.data))
    begun, shown = clock.monotonic(), -1

    def show(_: Any, data: Any) -> None:
        nonlocal shown
        if int(data.time / FRAME) > shown and window.is_running():
            shown = int(data.time / FRAME)
            window.sync()
            clock.sleep(max(0.0, begun + data.time - clock.monotonic()))

    return show


class _Simulation:
    """A robot on the plan's ground, and what it does."""

    def __init__(self, controller: Controller, start: Floats, report: Report) -> None:
        self.controller, self.machine, self.plan, self.report = controller, controller.machine, controller.plan, report
        random = None if report.seed is None else np.random.default_rng(report.seed)
        if random is not None:
            report.friction *= float(random.uniform(1 - FRICTION_SPREAD, 1 + FRICTION_SPREAD))
        self.model = self._world(report.friction)
        self.data = mj.MjData(self.model)
        self.data.qpos[:] = start
        if random is not None:
            self._disturb(random)
        mj.mj_forward(self.model, self.data)
        self.ground = self.model.geom(_ground.NAME).id
        m, base, own = self.model, self.machine.base, self.machine.model
        # The ground moves the numbers of geoms, not those of bodies.
        self.foot_of = {
            int(foot.geom - own.body_geomadr[foot.body] + m.body_geomadr[foot.body]): f
            for f, foot in enumerate(self.machine.feet)
            if foot.geom is not None
        }
        self.foot_on = {foot.body: f for f, foot in enumerate(self.machine.feet) if foot.geom is None}
        # The base and what hangs on it directly may not touch the ground.
        self.trunk = {b for b in range(m.nbody) if base in (m.body_weldid[b], m.body_weldid[m.body_parentid[m.body_weldid[b]]])}
        self.sliding = _Sliding(self.plan.n_feet, report)

    def _world(self, friction: float) -> Any:
        """The robot on the ground, without motors of its own: torques are given to its joints."""
        spec = self.machine.spec
        option = spec.option
        option.timestep, option.integrator = STEP, mj.mjtIntegrator.mjINT_IMPLICITFAST
        # Feet do not creep.
        option.cone, option.impratio = mj.mjtCone.mjCONE_ELLIPTIC, 100
        _ground.add(spec, self.plan.terrain, friction, self.plan.feet)
        model = spec.compile()
        # What diverges shall be seen.
        model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_ACTUATION | mj.mjtDisableBit.mjDSBL_AUTORESET
        return model

    def _disturb(self, random: np.random.Generator) -> None:
        """Changes masses and the start; the lowest foot stays where it is."""
        m, d = self.model, self.data
        shares = random.uniform(1 - MASS_SPREAD, 1 + MASS_SPREAD, m.nbody)
        m.body_mass *= shares
        m.body_inertia *= shares[:, None]
        mj.mj_setConst(m, mj.MjData(m))
        d.qpos[7:] += random.uniform(-JOINT_SPREAD, JOINT_SPREAD, m.nq - 7)
        d.qvel[:6] = random.uniform(-SPEED_SPREAD, SPEED_SPREAD, 6)
        state = self.machine.state(d.qpos, d.qvel)
        ball = [foot.radius * up for foot, up in zip(self.machine.feet, self.plan.normals[0])]
        sunk = [self.plan.terrain.height(*place[:2]) - place[2] for place in state.feet - ball]
        d.qpos[2] += max(sunk)

    def run(self, observers: Sequence[Observer]) -> None:
        """From standing to standing, or to the fall."""
        report, d = self.report, self.data
        errors: list[tuple[float, float]] = []
        missing = due = saturated = 0
        periods = round((self.plan.horizon + 2 * HOLD) / self.plan.step)
        for period in range(periods):
            time = period * self.plan.step - HOLD
            if not np.all(np.isfinite(d.qpos)):
                report.upright, report.fall_time, report.fall = False, time, "the simulation diverged"
                break
            state = self.machine.state(d.qpos, d.qvel)
            loads, trunk_touches = self._contacts()
            k = self.plan.index(time)
            away, turn = state.com - self.plan.position[k], _rotation.between(self.plan.rotation[k], state.rotation)
            errors.append((float(np.linalg.norm(away)), float(np.linalg.norm(turn))))
            report.fall = self._fall(state, k, away, trunk_touches)
            if report.fall:
                report.upright, report.fall_time = False, time
                break
            stands = self.plan.stands(k)
            loaded = loads > LOADED * report.mass * 9.80665 / len(loads)
            missing, due = missing + int(np.sum(stands & ~loaded)), due + int(np.sum(stands))
            self.sliding.add(self._slide(loaded, k, state), self.plan.phases[k])
            saturated += self._drive(time, state, loads)
            for observer in observers:
                observer(self.model, d)
        position, attitude = np.array(errors).T
        report.position_error_max, report.attitude_error_max = float(position.max()), float(attitude.max())
        report.position_error_rms, report.attitude_error_rms = (float(np.sqrt(np.mean(e**2))) for e in (position, attitude))
        # Where it stands, or lies, when the play ends.
        report.end_error = float(np.linalg.norm((state.com - self.plan.position[-1])[:2]))
        report.missing_contact = missing / max(due, 1)
        report.torque_saturated = saturated / max(len(errors), 1)

    def _contacts(self) -> tuple[Floats, bool]:
        """Normal force on each foot, N, and whether the trunk touches the ground."""
        loads, trunk = np.zeros(self.plan.n_feet), False
        force = np.zeros(6)
        for number in range(self.data.ncon):
            contact = self.data.contact[number]
            if self.ground not in (contact.geom1, contact.geom2):
                continue
            other = contact.geom2 if contact.geom1 == self.ground else contact.geom1
            body = int(self.model.geom_bodyid[other])
            # A foot that is named as a site stands on whatever its body has.
            foot = self.foot_of.get(int(other), self.foot_on.get(body))
            if foot is not None:
                mj.mj_contactForce(self.model, self.data, number, force)
                loads[foot] += force[0]
            else:
                trunk |= body in self.trunk
        return loads, trunk

    def _fall(self, state: State, k: int, away: Floats, trunk_touches: bool) -> Optional[str]:
        """How the robot has fallen, if it has."""
        planned = self.plan.position[k]
        ground = self.plan.terrain.height
        lean = float(np.arccos(np.clip(state.rotation[2, 2], -1, 1)))
        if trunk_touches:
            return "the trunk touches the ground"
        if lean > LEAN:
            return f"it leans by {np.degrees(lean):.0f} deg"
        if state.com[2] - ground(*state.com[:2]) < LOW * (planned[2] - ground(*planned[:2])):
            return "the base is too low"
        if float(np.linalg.norm(away)) > ASTRAY:
            return f"the base is more than {ASTRAY:g} m off the plan"
        return None

    def _slide(self, loaded: NDArray[np.bool_], k: int, state: State) -> Floats:
        """By how much the loaded feet slide in a period, m, shape (feet,)."""
        slides = np.zeros(self.plan.n_feet)
        for f in np.flatnonzero(loaded):
            foot, up = self.machine.feet[f], self.plan.normals[k, f]
            jacobian, _ = self.machine.jacobian(foot, state.feet[f] - foot.radius * up)
            velocity = jacobian @ state.velocity
            slides[f] = float(np.linalg.norm(velocity - (velocity @ up) * up)) * self.plan.step
        return slides

    def _drive(self, time: float, state: State, loads: Floats) -> bool:
        """A period of control; whether a motor is at its limit in it."""
        report, d, machine = self.report, self.data, self.machine
        command = self.controller.command(time, state, loads)
        report.unsolved += not command.solved
        at_limit = False
        for step in range(STEPS):
            speed = d.qvel[6:]
            low, high = torque_range(machine.torque_limits, speed, report.joint_speed_limit)
            torque = np.clip(command.torque_after(step * STEP, speed), low, high)
            shares = np.abs(torque) / machine.torque_limits
            at_limit |= bool(np.any((torque <= SATURATED * low) | (torque >= SATURATED * high)))
            if shares.max() > report.torque_share:
                report.torque_share, report.torque_joint = float(shares.max()), self._joint(int(shares.argmax()))
            if np.abs(speed).max() > report.joint_speed:
                report.joint_speed, report.speed_joint = float(np.abs(speed).max()), self._joint(int(np.abs(speed).argmax()))
            d.qfrc_applied[6:] = torque
            mj.mj_step(self.model, d)
        return at_limit

    def _joint(self, number: int) -> str:
        """Name of a joint behind the base."""
        return str(self.model.joint(self.model.dof_jntid[number + 6]).name)


class _Sliding:
    """How far feet slide while they bear load, in each stance and in all."""

    def __init__(self, n_feet: int, report: Report) -> None:
        self.report = report
        self.phases = np.full(n_feet, -1)
        self.in_phase = np.zeros(n_feet)

    def add(self, slides: Floats, phases: Floats) -> None:
        self.in_phase = np.where(phases == self.phases, self.in_phase, 0.0) + slides
        self.phases = phases
        self.report.slip_total += float(slides.sum())
        self.report.slip_max = max(self.report.slip_max, float(self.in_phase.max()))
