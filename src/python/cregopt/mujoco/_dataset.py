"""Motions of a data set as references of a MuJoCo model, in the files that mjlab and LocoMuJoCo read."""

from __future__ import annotations

import itertools
import json
import os
import pathlib
from dataclasses import dataclass, field
from typing import Any, Iterator, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .. import Error
from . import _plan
from ._engine import Floats, mj
from ._model import Machine, Path
from ._play import MASS_APART, assign_feet, play, velocities
from ._report import Report

#: Largest remaining error of inverse kinematics, m and rad, with which a frame counts as attained.
MISSED = 5e-3
#: Forms of files.
FORMS = ("mjlab", "loco-mujoco")


@dataclass(frozen=True)
class Reference:
    """Motion of a MuJoCo model at ``n`` equidistant instants, in MuJoCo's order of joints, bodies and sites. World frame, SI units."""

    #: Number of instants per second, Hz.
    rate: float
    #: Positions and velocities, MuJoCo's ``qpos`` and ``qvel``, shapes (n, nq) and (n, nv).
    qpos: Floats
    qvel: Floats
    #: Positions of bodies, shape (n, bodies, 3), quaternions w, x, y, z, shape (n, bodies, 4), and velocities of their origins, shape (n, bodies, 3).
    #: The first body is the world.
    body_position: Floats
    body_quaternion: Floats
    body_velocity: Floats
    body_angular_velocity: Floats
    #: MuJoCo's ``cvel``, shape (n, bodies, 6), and ``subtree_com``, shape (n, bodies, 3).
    cvel: Floats
    subtree_com: Floats
    #: Positions and rotation matrices of sites, shapes (n, sites, 3) and (n, sites, 9).
    site_position: Floats
    site_matrix: Floats
    #: Largest remaining error of inverse kinematics, m and rad; largest excess of a joint beyond its range, rad or m.
    missed: float
    beyond: float


@dataclass
class Exported:
    """Result of an export."""

    #: Files that were written.
    files: list[str] = field(default_factory=list)
    #: Number of motions in them, and of motions that the model cannot follow.
    motions: int = 0
    skipped: int = 0

    def __str__(self) -> str:
        return f"{self.motions} motions in {len(self.files)} files, {self.skipped} that the model cannot follow"


def reference(trajectory: _plan.Motion, model: Path, rate: float = 50.0, feet: Optional[Sequence[str]] = None) -> Reference:
    """Motion of a MuJoCo model along a plan.

    Centre of mass, attitude of the base, feet and their velocities are those of the plan. Joints that belong to no leg keep their values of the
    model's stance.

    Parameters
    ----------
    trajectory : Trajectory, Gait, dict or path
        The plan. Its base frame is the centre of mass with the axes of the model's first body.
    model : path
        MuJoCo model (MJCF or URDF) with a free base and legs; it needs no motors.
    rate : float, default 50
        Number of instants per second, Hz.
    feet : list of str, optional
        Geoms, bodies or sites that are the feet, in the plan's order. Default: the feet on which the model stands.

    Returns
    -------
    Reference
        Joints, bodies and sites at every instant.

    Raises
    ------
    Error
        If the plan or the model is invalid, or the plan is for another robot.
    ImportError
        If MuJoCo is not installed.
    """
    plan = _plan.read(trajectory, rate)
    return _follow(_machine(model, plan, feet), plan)


def _machine(model: Path, plan: _plan.Plan, feet: Optional[Sequence[str]]) -> Machine:
    """Model with its feet in the order of the plan. Raises Error if the plan is for another robot."""
    machine = Machine(model, feet, plan.n_feet, motors=False)
    if abs(machine.mass - plan.robot.mass) > MASS_APART * machine.mass:
        raise Error(f"the plan is for a robot of {plan.robot.mass:.4g} kg, the model {machine.name} weighs {machine.mass:.4g} kg, more than {100 * MASS_APART:g} % apart")
    if plan.soled != machine.soled:
        kinds = ["balls or points", "soles"]
        raise Error(f"the feet of the plan are {kinds[plan.soled]}, those of the model {machine.name} {kinds[machine.soled]}")
    if feet is None:
        assign_feet(machine, plan.robot.nominal_feet)
    return machine


def _follow(machine: Machine, plan: _plan.Plan) -> Reference:
    m, d, n = machine.model, machine.data, len(plan.position)
    soles = np.array([[plan.sole(i, f) for f in range(plan.n_feet)] for i in range(n)])
    radii = np.array([[foot.radius] for foot in machine.feet])
    low, high = m.jnt_range[1:].T
    limited, at = m.jnt_limited[1:] != 0, m.jnt_qposadr[1:]
    stance, missed, beyond = machine.stance, 0.0, 0.0
    parts: list[dict[str, Floats]] = []
    velocity = np.zeros(6)
    try:
        for i in range(n):
            left, pose = machine.inverse_kinematics(plan.position[i], plan.rotation[i], plan.feet[i] + radii * plan.normals[i], soles[i])
            # The next frame starts from this one.
            machine.stance = pose
            missed = max(missed, left)
            excess = np.maximum(low - pose[at], pose[at] - high)[limited]
            beyond = max(beyond, float(excess.max(initial=0.0)))
            d.qvel[:] = velocities(machine, plan, i, pose)
            mj.mj_fwdPosition(m, d)
            mj.mj_fwdVelocity(m, d)
            speeds = np.zeros((m.nbody, 6))
            for body in range(m.nbody):
                mj.mj_objectVelocity(m, d, mj.mjtObj.mjOBJ_XBODY, body, velocity, 0)
                speeds[body] = velocity
            parts.append(
                {
                    "qpos": d.qpos.copy(),
                    "qvel": d.qvel.copy(),
                    "body_position": d.xpos.copy(),
                    "body_quaternion": d.xquat.copy(),
                    "body_velocity": speeds[:, 3:],
                    "body_angular_velocity": speeds[:, :3],
                    "cvel": d.cvel.copy(),
                    "subtree_com": d.subtree_com.copy(),
                    "site_position": d.site_xpos.copy(),
                    "site_matrix": d.site_xmat.copy(),
                }
            )
    finally:
        machine.stance = stance
    arrays = {key: np.stack([part[key] for part in parts]) for key in parts[0]}
    return Reference(rate=1 / plan.step, missed=missed, beyond=beyond, **arrays)


def export(
    folder: Path, robot: str, model: Path, out: Path, form: str = "mjlab", *, feet: Optional[Sequence[str]] = None, most: Optional[int] = None
) -> Exported:
    """Writes the motions of a data set as references of a MuJoCo model.

    Parameters
    ----------
    folder : path
        Folder of ``cregopt dataset``.
    robot : str
        Robot of the data set: name of its folder.
    model : path
        MuJoCo model of the robot, that of the trainer. It needs no motors.
    out : path
        With ``form="mjlab"`` a folder for one file per motion, otherwise a file.
    form : "mjlab" or "loco-mujoco"
        Reader of the files: ``MotionLoader`` of mjlab's tracking task, or ``Trajectory.load`` of LocoMuJoCo.
    feet : list of str, optional
        Geoms, bodies or sites of the model that are the feet, in the order of the robot. Default: found.
    most : int, optional
        Largest number of motions. Default: all.

    Returns
    -------
    Exported
        Files and number of motions. Motions that the model cannot follow within its joint ranges are left out.

    Raises
    ------
    Error
        If the folder is not a data set, the robot not one of it, or the model that of another robot.
    ImportError
        If MuJoCo is not installed.
    """
    if form not in FORMS:
        raise Error(f"form {form!r}: must be one of {', '.join(FORMS)}")
    root, target, done, machine = pathlib.Path(folder), pathlib.Path(out), Exported(), None
    manifest = _manifest(root)
    rate = float(manifest["origin"]["spec"]["rate"])
    kept: list[Reference] = []
    for name, motion in _motions(root, manifest, robot):
        if most is not None and done.motions >= most:
            break
        plan = _plan.read(motion, rate)
        machine = machine or _machine(model, plan, feet)
        own = _follow(machine, plan)
        if own.missed > MISSED or own.beyond > MISSED:
            done.skipped += 1
            continue
        done.motions += 1
        if form == "mjlab":
            target.mkdir(parents=True, exist_ok=True)
            _save(target / f"{name}.npz", of_mjlab(own), done)
        else:
            kept.append(own)
    if machine is None or not done.motions:
        raise Error(f"{root}: robot {robot}: no motion that the model can follow")
    if form == "loco-mujoco":
        _save(target, of_loco_mujoco(machine, kept), done)
    return done


def play_dataset(
    folder: Path, robot: str, model: Path, *, feet: Optional[Sequence[str]] = None, most: Optional[int] = None, **options: Any
) -> dict[str, Report]:
    """Plays the motions of a data set on a model, like :func:`play`. Motions that begin or end in motion are played without standing there.

    Parameters
    ----------
    folder : path
        Folder of ``cregopt dataset``.
    robot : str
        Robot of the data set: name of its folder.
    model : path
        MuJoCo model of the robot, with motors.
    feet : list of str, optional
        Geoms, bodies or sites of the model that are the feet, in the order of the robot. Default: found.
    most : int, optional
        Largest number of motions. Default: all.
    **options
        Other options of :func:`play`, such as ``seed`` and ``friction``.

    Returns
    -------
    dict of str to Report
        Report of each motion, by the name of its file in :func:`export`.

    Raises
    ------
    Error
        If the folder is not a data set, the robot not one of it, or the model that of another robot.
    ImportError
        If MuJoCo or DAQP is not installed.
    """
    root = pathlib.Path(folder)
    motions = itertools.islice(_motions(root, _manifest(root), robot), most)
    return {name: play(motion, model, feet=feet, **options) for name, motion in motions}


def _motions(root: pathlib.Path, manifest: dict[str, Any], robot: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and motions of a robot. Raises Error if the data set does not have the robot."""
    robots = [entry["folder"] for entry in manifest["origin"]["robots"]]
    if robot not in robots:
        raise Error(f"{root / 'dataset.json'}: robot {robot!r}: must be one of {', '.join(robots)}")
    for shard in (shard for shard in manifest["shards"] if shard["robot"] == robot):
        lines = (root / shard["files"][2]["path"]).read_text(encoding="utf-8").splitlines()
        for number, line in enumerate(lines):
            yield f"{robot}-{shard['number']:05}-{number:05}", json.loads(line)


def _manifest(root: pathlib.Path) -> dict[str, Any]:
    path = root / "dataset.json"
    try:
        manifest: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise Error(f"{path}: {error}") from error
    if not {"origin", "shards"} <= set(manifest):
        raise Error(f"{path}: not the manifest of a data set")
    return manifest


def _save(path: pathlib.Path, arrays: dict[str, NDArray[Any]], done: Exported) -> None:
    """Writes a file under a temporary name and renames it."""
    part = path.with_name(path.name + ".part")
    with open(part, "wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
    os.replace(part, path)
    done.files.append(os.fspath(path))


def of_mjlab(of: Reference) -> dict[str, NDArray[Any]]:
    """Arrays of mjlab's ``MotionLoader``: joints without the free joint, bodies without the world, in the order of the model."""
    single = np.float32
    return {
        "fps": np.array([of.rate]),
        "joint_pos": of.qpos[:, 7:].astype(single),
        "joint_vel": of.qvel[:, 6:].astype(single),
        "body_pos_w": of.body_position[:, 1:].astype(single),
        "body_quat_w": of.body_quaternion[:, 1:].astype(single),
        "body_lin_vel_w": of.body_velocity[:, 1:].astype(single),
        "body_ang_vel_w": of.body_angular_velocity[:, 1:].astype(single),
    }


def of_loco_mujoco(machine: Machine, motions: Sequence[Reference]) -> dict[str, NDArray[Any]]:
    """Arrays of LocoMuJoCo's ``Trajectory``: all motions one after the other, with the indices at which they begin."""
    m = machine.model
    together = {
        "qpos": "qpos",
        "qvel": "qvel",
        "xpos": "body_position",
        "xquat": "body_quaternion",
        "cvel": "cvel",
        "subtree_com": "subtree_com",
        "site_xpos": "site_position",
        "site_xmat": "site_matrix",
    }
    arrays: dict[str, NDArray[Any]] = {key: np.concatenate([getattr(of, own) for of in motions]).astype(np.float32) for key, own in together.items()}
    arrays["split_points"] = np.concatenate([[0], np.cumsum([len(of.qpos) for of in motions])])
    # LocoMuJoCo's models name the free joint of the base `root`.
    arrays["joint_names"] = np.array([m.joint(joint).name or "root" for joint in range(m.njnt)])
    arrays["body_names"] = np.array([m.body(body).name for body in range(m.nbody)])
    if m.nsite:
        arrays["site_names"] = np.array([m.site(site).name for site in range(m.nsite)])
    arrays["frequency"] = np.array(motions[0].rate)
    for key in ("njnt", "nbody", "nsite"):
        arrays[key] = np.array(getattr(m, key))
    of_model = ["jnt_type", "body_rootid", "body_weldid", "body_mocapid", "body_pos", "body_quat", "body_ipos", "body_iquat", "site_bodyid", "site_pos", "site_quat"]
    arrays.update({key: getattr(m, key).copy() for key in of_model})
    return arrays
