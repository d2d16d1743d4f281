"""Simulation of a robot that follows a plan."""

from __future__ import annotations

import importlib
import time as clock
from contextlib import ExitStack
from typing import Any, Callable, Generic, Optional, Sequence, TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import Error, Terrain
from . import _ground, _plan, _rotation, _video
from ._controller import ON_SOLES, Controller, Gains, torque_range
from ._engine import Floats, mj
from ._model import Machine, Path, State
from ._report import MotorLoads, Report

#: Time step of the simulation, s, and number of steps per control period.
STEP, STEPS = 0.001, 2
#: Time between frames of the window, s.
FRAME = 0.02
#: Duration of standing before and after a plan that begins and ends at rest, s.
HOLD = 0.4
#: Largest difference between the masses of plan and model, as a share of the model's mass.
MASS_APART = 0.05
#: Largest distance between the feet of the model and those at the start of the plan, m.
START_MISSED = 0.01
#: Limits beyond which a robot has fallen: lean, rad; height of the base as a share of the planned height; distance of the base from the plan, m.
LEAN, LOW, ASTRAY = float(np.radians(60.0)), 0.5, 1.0
#: Normal force from which a foot counts as loaded, as a share of weight per foot.
LOADED = 0.05
#: Largest disturbances by a seed: of friction and masses, as shares; of joints, rad; of base velocities, m/s and rad/s.
FRICTION_SPREAD, MASS_SPREAD, JOINT_SPREAD, SPEED_SPREAD = 0.1, 0.03, 0.01, 0.05
#: Share of the torque limit from which a motor counts as saturated.
SATURATED = 0.99

#: Report to which a simulation adds the loads of the motors.
Loads = TypeVar("Loads", bound=MotorLoads)
#: Callback for each control period, with MuJoCo's model and data.
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
    """Plays a plan on a robot in MuJoCo, with a whole-body controller that respects the limits of the motors.

    Parameters
    ----------
    trajectory : Trajectory, Gait, dict or path
        The plan. Its base frame is the centre of mass with the axes of the model's first body.
    model : path
        MuJoCo model with a free base and legs, all of whose joints have motors, or URDF file, which gets both. The geometry of its world is
        replaced by the terrain of the plan.
    feet : list of str, optional
        Geoms (balls or capsules), bodies or sites that are the feet, in the plan's order. Default: the feet on which the model stands, each assigned
        to the nearest foot of the plan.
    friction : float, optional
        Friction coefficient of the ground, which the controller knows. Default: the plan's.
    seed : int, optional
        Seed of disturbances that the controller does not know: of friction (up to 10 %), of the masses of all bodies (3 %), and at the start of the
        joints (0.01 rad) and of the base velocities (0.05 m/s and rad/s). Default: no disturbances.
    speed_limit : float, default 30
        Joint speed at which the motors have no torque left, rad/s; the torque fades from two thirds of it. Model files do not contain it.
    gains : Gains, optional
        Gains and weights of the controller. Default: ``Gains()``, on soles with a ``weight_attitude`` of 0.3.
    video : path, optional
        File for an animation: .gif, .png (APNG) or .webp.
    viewer : bool, default False
        Show the simulation in a window, in real time.

    Returns
    -------
    Report
        Falls, tracking errors, slip and motor loads.

    Raises
    ------
    Error
        If the plan or the model is invalid, or the plan is for another robot: another number of feet, a mass that differs by more than 5 %, or legs
        that cannot reach the start of the plan.
    ImportError
        If MuJoCo or DAQP is not installed.
    """
    check(speed_limit, friction, seed, video, viewer)
    plan = _plan.read(trajectory, 1 / (STEP * STEPS))
    machine = Machine(model, feet, plan.n_feet)
    if abs(machine.mass - plan.robot.mass) > MASS_APART * machine.mass:
        raise Error(
            f"the plan is for a robot of {plan.robot.mass:.4g} kg, the model {machine.name} weighs {machine.mass:.4g} kg, more than "
            f"{100 * MASS_APART:g} % apart; cregopt.mujoco.robot makes a robot from a model"
        )
    if feet is None:
        assign_feet(machine, plan.robot.nominal_feet)
    if plan.soled != machine.soled:
        kinds = ["balls or points", "soles"]
        raise Error(
            f"the feet of the plan are {kinds[plan.soled]}, those of the model {machine.name} {kinds[machine.soled]}; "
            "cregopt.mujoco.robot makes a robot from a model"
        )
    start = start_pose(machine, plan)
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
    controller = Controller(machine, plan, friction, speed_limit, gains or (ON_SOLES if machine.soled else Gains()))
    simulation = _Play(controller, start, report)
    with ExitStack() as stack:
        observers: list[Observer] = []
        if video is not None:
            observers.append(stack.enter_context(_video.Film(video, simulation.model, machine.base, 5 * float(plan.position[0, 2]), 1 / plan.step)))
        if viewer:
            observers.append(window(stack, simulation))
        simulation.run(observers)
    return report


def check(speed_limit: float, friction: Optional[float], seed: Optional[int], video: Optional[Path], viewer: bool) -> None:
    """Checks arguments of simulations, and prepares the drawing. Raises Error for the first bad one."""
    if not (np.isfinite(speed_limit) and speed_limit > 0):
        raise Error(f"speed limit {speed_limit!r}: must be positive, rad/s")
    if friction is not None and not (np.isfinite(friction) and friction > 0):
        raise Error(f"friction {friction!r}: must be positive")
    if seed is not None and seed < 0:
        raise Error(f"seed {seed!r}: must not be negative")
    if video is not None:
        _video.prepare(video)
    if viewer and _video.headless():
        raise Error("no window can be opened: there is no display")


def assign_feet(machine: Machine, nominal: Floats) -> None:
    """Puts the feet of the model in the order of the nominal feet of a robot: each is the nearest one."""
    order = _plan.order_of_feet(nominal, machine.nominal_feet())
    machine.feet = [machine.feet[of] for of in order]


def start_pose(machine: Machine, plan: _plan.Plan) -> Floats:
    """Pose (``qpos``) at the start of the plan. Raises Error if the legs cannot reach it."""
    balls = plan.feet[0] + [[foot.radius] for foot in machine.feet] * plan.normals[0]
    soles = np.array([plan.sole(0, f) for f in range(plan.n_feet)])
    missed, pose = machine.inverse_kinematics(plan.position[0], plan.rotation[0], balls, soles)
    if missed > START_MISSED:
        raise Error(
            f"the legs of the model {machine.name} cannot reach the start of the plan: they miss it by {missed:.3f} m; "
            "cregopt.mujoco.robot makes a robot from a model"
        )
    return pose


def velocities(machine: Machine, plan: _plan.Plan, i: int, pose: Floats) -> Floats:
    """Velocities (``qvel``) with which centre of mass, base and feet move as the plan does at an instant, in its pose (``qpos``)."""
    m, d = machine.model, machine.data
    before, after = max(i - 1, 0), min(i + 1, len(plan.position) - 1)
    machine._pose(pose)
    rates = np.zeros(m.nv)
    rates[3:6] = plan.rotation[i].T @ plan.angular_velocity[i]
    rows, wanted = [], []
    for f, foot in enumerate(machine.feet):
        jacobian, turns = np.zeros((3, m.nv)), np.zeros((3, m.nv))
        mj.mj_jac(m, d, jacobian, turns, machine.place(foot), foot.body)
        rows.append(jacobian)
        wanted.append(plan.feet_velocity[i, f])
        if foot.sole is not None:
            rows.append(turns)
            wanted.append(_rotation.between(plan.sole(before, f), plan.sole(after, f)) / ((after - before) * plan.step))
    com = np.zeros((3, m.nv))
    mj.mj_jacSubtreeCom(m, d, com, machine.base)
    rows.append(com)
    wanted.append(plan.velocity[i])
    jacobian, free = np.concatenate(rows), [0, 1, 2, *machine._leg_dofs()]
    rates[free] = np.linalg.lstsq(jacobian[:, free], np.concatenate(wanted) - jacobian @ rates, rcond=None)[0]
    return rates


def window(stack: ExitStack, simulation: Simulation[Any]) -> Observer:
    """Observer that shows a simulation in a window, in real time."""
    window = stack.enter_context(importlib.import_module("mujoco.viewer").launch_passive(simulation.model, simulation.data))
    begun, shown = clock.monotonic(), -1

    def show(_: Any, data: Any) -> None:
        nonlocal shown
        if int(data.time / FRAME) > shown and window.is_running():
            shown = int(data.time / FRAME)
            window.sync()
            clock.sleep(max(0.0, begun + data.time - clock.monotonic()))

    return show


class Simulation(Generic[Loads]):
    """Simulation of a robot under a controller on a ground, with its report."""

    def __init__(
        self,
        controller: Controller,
        start: Floats,
        report: Loads,
        ground: Terrain,
        covered: Floats,
        patches: Sequence[_ground.Patch] = (),
        moving: Optional[Floats] = None,
    ) -> None:
        self.controller, self.machine, self.plan, self.report = controller, controller.machine, controller.plan, report
        if not np.all(np.isfinite(self.machine.torque_limits)):
            report.notes.append("the model has no torque limits for some joints")
        random = None if report.seed is None else np.random.default_rng(report.seed)
        if random is not None:
            report.friction *= float(random.uniform(1 - FRICTION_SPREAD, 1 + FRICTION_SPREAD))
        self.model, grounds = self._world(report.friction, ground, covered, patches)
        self.data = mj.MjData(self.model)
        self.data.qpos[:] = start
        if moving is not None:
            self.data.qvel[:] = moving
        if random is not None:
            self._disturb(random)
        mj.mj_forward(self.model, self.data)
        self.grounds = {self.model.geom(name).id for name in grounds}
        m, base, own = self.model, self.machine.base, self.machine.model
        # Adding the ground shifts the indices of geoms, not those of bodies.
        self.foot_of = {
            int(foot.geom - own.body_geomadr[foot.body] + m.body_geomadr[foot.body]): f
            for f, foot in enumerate(self.machine.feet)
            if foot.geom is not None
        }
        self.foot_on = {int(m.body_weldid[foot.body]): f for f, foot in enumerate(self.machine.feet) if foot.geom is None}
        # The trunk, which may not touch the ground: the base and its direct children.
        self.trunk = {b for b in range(m.nbody) if base in (m.body_weldid[b], m.body_weldid[m.body_parentid[m.body_weldid[b]]])}

    def _world(self, friction: float, ground: Terrain, covered: Floats, patches: Sequence[_ground.Patch]) -> tuple[Any, list[str]]:
        """Model of the robot on the ground around the positions ``covered``, shape (n, feet, 3), and names of the ground's geoms.

        The model's actuators are off: torques are applied to the joints.
        """
        spec = self.machine.spec
        option = spec.option
        option.timestep, option.integrator = STEP, mj.mjtIntegrator.mjINT_IMPLICITFAST
        # Elliptic cones and a high impedance ratio: otherwise loaded feet creep.
        option.cone, option.impratio = mj.mjtCone.mjCONE_ELLIPTIC, 100
        names = _ground.add(spec, ground, friction, covered, patches)
        model = spec.compile()
        # Without automatic resets, divergence is detected.
        model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_ACTUATION | mj.mjtDisableBit.mjDSBL_AUTORESET
        return model, names

    def _disturb(self, random: np.random.Generator) -> None:
        """Disturbs the masses and the initial state. The lowest foot stays on the ground."""
        m, d = self.model, self.data
        shares = random.uniform(1 - MASS_SPREAD, 1 + MASS_SPREAD, m.nbody)
        m.body_mass *= shares
        m.body_inertia *= shares[:, None]
        mj.mj_setConst(m, mj.MjData(m))
        d.qpos[7:] += random.uniform(-JOINT_SPREAD, JOINT_SPREAD, m.nq - 7)
        d.qvel[:6] += random.uniform(-SPEED_SPREAD, SPEED_SPREAD, 6)
        state = self.machine.state(d.qpos, d.qvel)
        places = np.concatenate([self.controller.contact_points(f, 0, state) for f in range(self.plan.n_feet)])
        d.qpos[2] += max(self.plan.terrain.height(*place[:2]) - place[2] for place in places)

    def _contacts(self) -> tuple[Floats, bool]:
        """Normal force on each foot, N, shape (feet,), and True if the trunk touches the ground."""
        loads, trunk = np.zeros(self.plan.n_feet), False
        force = np.zeros(6)
        for number in range(self.data.ncon):
            contact = self.data.contact[number]
            if self.grounds.isdisjoint((contact.geom1, contact.geom2)):
                continue
            other = contact.geom2 if contact.geom1 in self.grounds else contact.geom1
            body = int(self.model.geom_bodyid[other])
            # A sole and a foot that is a site touch the ground with any geom of their rigid part.
            foot = self.foot_of.get(int(other), self.foot_on.get(int(self.model.body_weldid[body])))
            if foot is not None:
                mj.mj_contactForce(self.model, self.data, number, force)
                loads[foot] += force[0]
            else:
                trunk |= body in self.trunk
        return loads, trunk

    def _drive(self, time: float, state: State, loads: Floats) -> bool:
        """Simulates one control period. Returns True if a motor was saturated."""
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

    def _toppled(self, state: State, trunk_touches: bool) -> Optional[str]:
        """Description of a fall onto the trunk or the side, or None."""
        lean = float(np.arccos(np.clip(state.rotation[2, 2], -1, 1)))
        if trunk_touches:
            return "the trunk touches the ground"
        return f"it leans by {np.degrees(lean):.0f} deg" if lean > LEAN else None

    def _joint(self, number: int) -> str:
        """Name of the joint with this index, not counting the base."""
        return str(self.model.joint(self.model.dof_jntid[number + 6]).name)


class _Play(Simulation[Report]):
    """Simulation of a robot that follows one plan."""

    def __init__(self, controller: Controller, start: Floats, report: Report) -> None:
        plan = controller.plan
        moving = None if plan.rests(0) else velocities(controller.machine, plan, 0, start)
        super().__init__(controller, start, report, plan.terrain, plan.feet, moving=moving)
        self.sliding = _Sliding(self.plan.n_feet, report)

    def run(self, observers: Sequence[Observer]) -> None:
        """Simulates the plan, with standing before and after it where it rests, or until the robot falls."""
        report, d = self.report, self.data
        errors: list[tuple[float, float]] = []
        missing = due = saturated = 0
        before, after = (HOLD * self.plan.rests(k) for k in (0, -1))
        periods = round((self.plan.horizon + before + after) / self.plan.step)
        for period in range(periods):
            time = period * self.plan.step - before
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
        # The last state: standing, or lying after a fall.
        report.end_error = float(np.linalg.norm((state.com - self.plan.position[-1])[:2]))
        report.missing_contact = missing / max(due, 1)
        report.torque_saturated = saturated / max(len(errors), 1)

    def _fall(self, state: State, k: int, away: Floats, trunk_touches: bool) -> Optional[str]:
        """Description of the fall, or None if the robot has not fallen."""
        planned = self.plan.position[k]
        ground = self.plan.terrain.height
        toppled = self._toppled(state, trunk_touches)
        if toppled:
            return toppled
        if state.com[2] - ground(*state.com[:2]) < LOW * (planned[2] - ground(*planned[:2])):
            return "the base is too low"
        if float(np.linalg.norm(away)) > ASTRAY:
            return f"the base is more than {ASTRAY:g} m off the plan"
        return None

    def _slide(self, loaded: NDArray[np.bool_], k: int, state: State) -> Floats:
        """Distance that each loaded foot slides along the ground in a control period, m, shape (feet,)."""
        slides = np.zeros(self.plan.n_feet)
        for f in np.flatnonzero(loaded):
            foot, up = self.machine.feet[f], self.plan.normals[k, f]
            jacobian, _ = self.machine.jacobian(foot, state.feet[f] - foot.radius * up)
            velocity = jacobian @ state.velocity
            slides[f] = float(np.linalg.norm(velocity - (velocity @ up) * up)) * self.plan.step
        return slides


class _Sliding:
    """Distances that loaded feet slide, per stance and in total."""

    def __init__(self, n_feet: int, report: Report) -> None:
        self.report = report
        self.phases = np.full(n_feet, -1)
        self.in_phase = np.zeros(n_feet)

    def add(self, slides: Floats, phases: Floats) -> None:
        """Adds the slides of a control period, m, and the phases of the feet; both shape (feet,)."""
        self.in_phase = np.where(phases == self.phases, self.in_phase, 0.0) + slides
        self.phases = phases
        self.report.slip_total += float(slides.sum())
        self.report.slip_max = max(self.report.slip_max, float(self.in_phase.max()))
