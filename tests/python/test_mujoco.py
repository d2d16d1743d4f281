"""Plans that a small robot plays in MuJoCo, and commands by which it is driven."""

import contextlib
import copy
import io
import itertools
import json
import math
import os
import pathlib
import re
import subprocess
import sys
from typing import Any, Callable

import cregopt
import cregopt.mujoco
import cregopt.mujoco.__main__
import numpy as np
import pytest
from cregopt.mujoco import _ground, _plan
from cregopt.mujoco._controller import Controller
from cregopt.mujoco._model import Machine, State

pytest.importorskip("mujoco")
pytest.importorskip("daqp")

LEG = """
<body name="{name}_hip" pos="{x} {y} 0">
  <inertial pos="0 0 0" mass="0.5" diaginertia="6e-4 6e-4 6e-4"/>
  <joint name="{name}_roll" axis="1 0 0" range="-0.9 0.9"/>
  <body name="{name}_thigh" pos="0 {out} 0">
    <joint name="{name}_pitch" axis="0 1 0" range="-1.5 3.2"/>
    <geom type="capsule" size="0.015" fromto="0 0 0 0 0 -0.2" mass="0.6"/>
    <body name="{name}_shank" pos="0 0 -0.2">
      <joint name="{name}_knee" axis="0 1 0" range="-2.7 -0.6"/>
      <geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.18" mass="0.15"/>
      <geom name="{name}" type="sphere" size="0.02" pos="0 0 -0.2" mass="0.05"/>
      <site name="{name}_tip" pos="0 0 -0.22"/>
    </body>
  </body>
</body>
"""


def mjcf(legs: dict[str, tuple[float, float]], trunk: float = 7.0) -> str:
    """Model of a box on legs with three motors each, without a keyframe. Its own floor must be ignored."""
    bodies = "".join(LEG.format(name=name, x=x, y=y, out=math.copysign(0.06, y)) for name, (x, y) in legs.items())
    limits = {"roll": 20, "pitch": 20, "knee": 35}
    motors = "".join(f'<motor joint="{leg}_{joint}" ctrlrange="-{limit} {limit}"/>' for leg in legs for joint, limit in limits.items())
    return f"""
<mujoco model="small">
  <compiler angle="radian"/>
  <default><joint damping="0.1" armature="0.01"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1" pos="0 0 0.3"/>
    <body name="trunk" pos="0 0 0.5">
      <freejoint/>
      <geom type="box" size="0.2 0.07 0.05" mass="{trunk}"/>
      {bodies}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""


# Legs in another order than in plans: position of the hip, m.
LEGS = {"RR": (-0.18, -0.06), "FL": (0.18, 0.06), "FR": (0.18, -0.06), "RL": (-0.18, 0.06)}


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    path = tmp_path_factory.mktemp("model") / "small.xml"
    path.write_text(mjcf(LEGS))
    return path


@pytest.fixture(scope="module")
def trot(model: pathlib.Path) -> cregopt.Gait:
    task = cregopt.Task(cregopt.mujoco.robot(model), cregopt.Terrain("flat", friction=0.7), goal=(0.5, 0.1), yaw=0.2)
    gait = cregopt.search(task, gaits="trot", first=True, device="cpu")
    assert gait.feasible
    return gait


def test_a_robot_is_made_from_a_model(model: pathlib.Path) -> None:
    robot = cregopt.mujoco.robot(model)
    assert robot.mass == pytest.approx(7 + 4 * 1.3)
    feet = robot.nominal_feet
    # Front before rear, left before right, all at the same height.
    assert np.array_equal(np.sign(feet[:, :2]), [[1, 1], [1, -1], [-1, 1], [-1, -1]])
    assert np.ptp(feet[:, 2]) < 1e-9 and -0.4 < feet[0, 2] < -0.2
    described = robot.to_dict()
    # Bounds on the inertia about z: the trunk as a box, with the masses of the legs at the hips or further out.
    trunk = 7 / 12 * (0.4**2 + 0.14**2)
    assert trunk + 4 * 1.3 * 0.18**2 < described["inertia"][2][2] < trunk + 4 * 1.3 * (0.25**2 + 0.13**2)
    assert np.allclose(described["inertia"], np.transpose(described["inertia"]))
    assert described["foot_radius"] == 0.02
    assert all(0.02 < half < 0.15 for half in described["reach"])


def test_a_trot_stays_upright_and_follows_its_plan(trot: cregopt.Gait, model: pathlib.Path) -> None:
    report = cregopt.mujoco.play(trot, model)
    assert report.upright and report.followed and report.fall is None, str(report)
    assert report.position_error_rms < report.position_error_max < 0.05
    assert report.end_error < 0.03
    assert 0.2 < report.torque_share <= 1
    assert 1 < report.joint_speed < report.joint_speed_limit
    assert report.missing_contact < 0.2 and report.slip_max < 0.05
    assert (report.friction, report.seed, report.unsolved) == (0.7, None, 0)


def test_seeded_disturbances_are_reproducible(trot: cregopt.Gait, model: pathlib.Path) -> None:
    once, again = (cregopt.mujoco.play(trot, model, seed=4, friction=0.6) for _ in range(2))
    assert once == again
    assert once.friction != 0.6 and abs(once.friction / 0.6 - 1) <= 0.1
    assert once.followed and once != cregopt.mujoco.play(trot, model, seed=5, friction=0.6)


def swapped(plan: dict[str, Any], robot: cregopt.Robot, one: int, other: int) -> dict[str, Any]:
    """Plan in which two feet have exchanged their motions."""
    plan, away = copy.deepcopy(plan), robot.nominal_feet[other] - robot.nominal_feet[one]
    for values in (plan["durations"], plan["ee"]):
        values[one], values[other] = values[other], values[one]
    for foot, sign in ((one, -1), (other, 1)):
        for node in plan["ee"][foot]["motion"]["nodes"]:
            node[:3] = list(np.array(node[:3]) + sign * away)
    return plan


def test_a_plan_with_the_wrong_footfall_order_falls(trot: cregopt.Gait, model: pathlib.Path) -> None:
    # A bound, both front feet and then both hind feet, with the base motion of a trot.
    bound = swapped(trot.trajectory.to_dict(), trot.task.robot, 1, 3)
    report = cregopt.mujoco.play(bound, model)
    assert not report.upright and report.fall and report.fall_time is not None and 0 < report.fall_time < report.horizon, str(report)
    assert not report.followed and "falls at" in str(report)


def test_forces_that_contradict_the_motion_are_reported(trot: cregopt.Gait, model: pathlib.Path) -> None:
    plan = trot.trajectory.to_dict()
    for foot in plan["ee"]:
        foot["force"]["nodes"] = [[3 * value for value in node] for node in foot["force"]["nodes"]]
    report = cregopt.mujoco.play(plan, model)
    assert not report.followed and report.position_error_max > 0.1, str(report)


def test_ice_and_weak_motors_are_reported(trot: cregopt.Gait, model: pathlib.Path, tmp_path: pathlib.Path) -> None:
    ice = cregopt.mujoco.play(trot, model, friction=0.03)
    assert not ice.followed, str(ice)
    weak = tmp_path / "weak.xml"
    weak.write_text(mjcf(LEGS).replace('ctrlrange="-20 20"', 'ctrlrange="-3 3"').replace('ctrlrange="-35 35"', 'ctrlrange="-3 3"'))
    report = cregopt.mujoco.play(trot, weak)
    assert not report.upright and report.fall_time is not None and report.fall
    assert report.torque_share == pytest.approx(1) and report.torque_saturated > 0.3


def test_the_terrain_of_the_plan_is_simulated(model: pathlib.Path) -> None:
    x = np.arange(-2, 3, 0.05)
    hill = np.tile(0.06 / (1 + np.exp(-(x - 0.4) / 0.1)), (len(x), 1)).T
    terrain = cregopt.Terrain.heights(hill, cell=0.05, origin=(-2, -2))
    gait = cregopt.search(cregopt.Task(cregopt.mujoco.robot(model), terrain, goal=(0.8, 0.0)), gaits="trot,walk", device="cpu", first=True)
    assert gait.feasible
    report = cregopt.mujoco.play(gait, model)
    assert report.followed, str(report)
    level = gait.trajectory.to_dict()
    level["terrain"] = cregopt.Terrain("flat").to_dict()
    assert cregopt.mujoco.play(level, model).position_error_max > 0.03 > report.position_error_max


def test_plans_for_other_robots_are_rejected(trot: cregopt.Gait, model: pathlib.Path, tmp_path: pathlib.Path) -> None:
    six = tmp_path / "six.xml"
    six.write_text(mjcf({**LEGS, "ML": (0.0, 0.1), "MR": (0.0, -0.1)}))
    heavy = tmp_path / "heavy.xml"
    heavy.write_text(mjcf(LEGS, trunk=8.0))
    stuck = tmp_path / "stuck.xml"
    stuck.write_text(mjcf(LEGS).replace("<freejoint/>", ""))
    weightless = tmp_path / "passive.xml"
    weightless.write_text(mjcf(LEGS).replace('<motor joint="FL_knee" ctrlrange="-35 35"/>', ""))
    cases = [
        (six, None, "the model six has 6 feet (FL, FR, ML, MR, RL, RR), the plan 4"),
        (heavy, None, "the plan is for a robot of 12.2 kg, the model heavy weighs 13.2 kg, more than 5 % apart"),
        (stuck, None, "the model stuck has no free joint at its base"),
        (weightless, None, "joint FL_knee of the model passive has no motor"),
        (tmp_path / "none.xml", None, "none.xml: there is no such model file"),
        (model, ["FL", "FR", "RL"], "the model small has 3 feet (FL, FR, RL), the plan 4"),
        (model, ["FL", "FR", "RL", "tail"], "no geom, body or site 'tail'; at the ends of its legs are: RR, FL, FR, RL"),
        (model, ["FL", "FR", "RL", "trunk"], "'trunk' of the model small is not a foot"),
    ]
    for path, feet, message in cases:
        with pytest.raises(cregopt.Error) as error:
            cregopt.mujoco.play(trot, path, feet=feet)
        assert message in str(error.value)
    with pytest.raises(cregopt.Error, match="friction -1"):
        cregopt.mujoco.play(trot, model, friction=-1)
    with pytest.raises(cregopt.Error, match=r"film.avi: an animation is one of \.gif"):
        cregopt.mujoco.play(trot, model, video="film.avi")


def test_position_servos_give_the_same_result_as_torque_motors(trot: cregopt.Gait, model: pathlib.Path, tmp_path: pathlib.Path) -> None:
    servos = tmp_path / "small.xml"
    motors = re.compile(r'<motor joint="(\w+)" ctrlrange="-(\d+) \d+"/>')
    text, n = motors.subn(r'<position joint="\1" kp="50" forcerange="-\2 \2"/>', model.read_text())
    servos.write_text(text)
    assert n == 12 and cregopt.mujoco.play(trot, servos) == cregopt.mujoco.play(trot, model)


def test_a_hexapod_walks_with_a_tripod_gait(tmp_path: pathlib.Path) -> None:
    model = tmp_path / "six.xml"
    model.write_text(mjcf({**LEGS, "ML": (0.0, 0.12), "MR": (0.0, -0.12)}))
    task = cregopt.Task(cregopt.mujoco.robot(model), cregopt.Terrain("flat"), goal=(0.3, 0.0))
    gait = cregopt.search(task, gaits="tripod", first=True, device="cpu")
    report = cregopt.mujoco.play(gait, model)
    assert gait.feasible and report.followed, str(report)


def test_an_animation_has_the_expected_number_of_frames(
    trot: cregopt.Gait, model: pathlib.Path, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = pytest.importorskip("PIL.Image")
    film = tmp_path / "film.gif"
    monkeypatch.setattr("cregopt.mujoco._video.RATE", 5)
    try:
        report = cregopt.mujoco.play(trot, model, video=film)
    except cregopt.Error as error:
        if os.environ.get("MUJOCO_TESTS") == "require":
            raise
        pytest.skip(str(error))
    assert list(tmp_path.iterdir()) == [film]
    with image.open(film) as shown:
        assert shown.n_frames == pytest.approx(5 * (report.horizon + 0.8), abs=1)
        shown.seek(shown.n_frames // 2)
        # A picture of a robot on its ground has many colours.
        assert len(shown.convert("RGB").getcolors(1 << 20)) > 20


def test_feet_can_be_given_by_bodies_and_sites(trot: cregopt.Gait, model: pathlib.Path) -> None:
    named = cregopt.mujoco.play(trot, model, feet=["FL_shank", "FR_shank", "RL_shank", "RR_shank"])
    assert named == cregopt.mujoco.play(trot, model)
    # Sites at the lowest points of the balls.
    tips = cregopt.mujoco.play(trot, model, feet=["FL_tip", "FR_tip", "RL_tip", "RR_tip"])
    assert tips != named and tips.followed and tips.missing_contact < 0.2, str(tips)


HUMAN_LEG = """
<body name="{side}_hip" pos="0 {y} -0.1">
  <joint name="{side}_yaw" axis="0 0 1" range="-1 1"/>
  <inertial pos="0 0 0" mass="0.3" diaginertia="4e-4 4e-4 4e-4"/>
  <body>
    <joint name="{side}_roll" axis="1 0 0" range="-0.8 0.8"/>
    <inertial pos="0 0 0" mass="0.3" diaginertia="4e-4 4e-4 4e-4"/>
    <body>
      <joint name="{side}_pitch" axis="0 1 0" range="-1.8 1.2"/>
      <geom type="capsule" size="0.03" fromto="0 0 -0.03 0 0 -0.22" mass="1.5" contype="0" conaffinity="0"/>
      <body pos="0 0 -0.25">
        <joint name="{side}_knee" axis="0 1 0" range="0 2.4"/>
        <geom type="capsule" size="0.025" fromto="0 0 -0.03 0 0 -0.22" mass="1" contype="0" conaffinity="0"/>
        <body pos="0 0 -0.25">
          <joint name="{side}_ankle" axis="0 1 0" range="-1.2 0.9"/>
          <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
          <body name="{side}_foot">
            <joint name="{side}_tilt" axis="1 0 0" range="-0.6 0.6"/>
            {foot}
          </body>
        </body>
      </body>
    </body>
  </body>
</body>
"""
#: Foot geometry: the rectangle of 0.2 m by 0.08 m about (0.03, 0, -0.06) m that touches the ground.
BOX_FOOT = '<geom type="box" size="0.1 0.04 0.015" pos="0.03 0 -0.045" mass="0.4"/>'


def human(foot: str = BOX_FOOT) -> str:
    """Model of a torso on two legs with six motors each and stretched knees, and an arm that belongs to no leg."""
    legs = "".join(HUMAN_LEG.format(side=side, y=y, foot=foot) for side, y in (("right", -0.09), ("left", 0.09)))
    names = [f"{side}_{joint}" for side in ("right", "left") for joint in ("yaw", "roll", "pitch", "knee", "ankle", "tilt")]
    motors = "".join(f'<motor joint="{name}" ctrlrange="-80 80"/>' for name in [*names, "arm"])
    return f"""
<mujoco model="human">
  <compiler angle="radian"/>
  <default><joint damping="0.1" armature="0.01"/></default>
  <worldbody>
    <body name="torso" pos="0 0 1">
      <freejoint/>
      <geom type="box" size="0.08 0.12 0.15" pos="0 0 0.1" mass="10"/>
      <body pos="0 0.15 0.2">
        <joint name="arm" axis="0 1 0" range="-1.5 1.5"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.25" mass="1"/>
      </body>
      {legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def humanoid(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    path = tmp_path_factory.mktemp("humanoid") / "human.xml"
    path.write_text(human())
    return path


def test_soles_are_found_in_the_geometry_of_feet(humanoid: pathlib.Path, tmp_path: pathlib.Path) -> None:
    robot = cregopt.mujoco.robot(humanoid)
    described = robot.to_dict()
    assert robot.mass == pytest.approx(10 + 1 + 2 * 3.6)
    assert described["sole"] == {"length": pytest.approx(0.2), "width": pytest.approx(0.08), "turn": 0.3} and "foot_radius" not in described
    # Point masses on a straight leg: thigh, shank, ankle and foot.
    legs = 1.5 * 0.125**2 + 1 * 0.375**2 + 0.1 * 0.5**2 + 0.4 * 0.545**2
    assert described["leg_mass"] == pytest.approx(legs / 0.56**2, rel=0.05)
    # Left before right, under the centre of mass, with bent knees: the legs are 0.56 m long, and the centre of mass is not far from the hips.
    height = described["base_height"]
    assert np.allclose(robot.nominal_feet, [[0, 0.09, -height], [0, -0.09, -height]], atol=1e-6) and 0.45 < height < 0.6
    left, right = described["reach"]
    (back, front), (inner, outer), (down, up) = left["sides"]
    assert right == {"sides": [[back, front], [-outer, -inner], [down, up]], "diagonals": left["diagonals"]}
    # A low foot is not far ahead, a high one not far behind.
    lean = left["diagonals"][1]
    assert lean["normal"] == [-0.6, 0, 0.8] and -lean["sides"][0] < 0.6 * front - 0.8 * down and lean["sides"][1] < -0.6 * back + 0.8 * up
    assert back < -0.05 and front > 0.05 and outer > 0.02 and down < -0.005 and up > 0.03
    # Soles keep apart.
    assert inner < 0 and 2 * (0.09 + inner) > 0.08
    shapes = {
        "balls": "".join(f'<geom type="sphere" size="0.01" pos="{0.03 + x} {y} -0.05" mass="0.1"/>' for x in (-0.1, 0.1) for y in (-0.04, 0.04)),
        "bars": "".join(f'<geom type="capsule" size="0.01" fromto="-0.07 {y} -0.05 0.13 {y} -0.05" mass="0.2"/>' for y in (-0.04, 0.04)),
        "plate": BOX_FOOT + '<geom type="cylinder" size="0.02 0.02" pos="0.03 0 -0.01" mass="0.1"/>',
        "inclined": BOX_FOOT.replace("/>", ' euler="0 0.05 0"/>'),
    }
    for name, foot in shapes.items():
        path = tmp_path / f"{name}.xml"
        path.write_text(human(foot))
        sole = cregopt.mujoco.robot(path).to_dict()["sole"]
        assert (sole["length"], sole["width"]) == pytest.approx((0.2, 0.08)), name
    # Geoms that touch the world by explicit pairs only.
    paired = human().replace(BOX_FOOT, BOX_FOOT.replace("/>", ' name="right" contype="0" conaffinity="0"/>'), 1)
    paired = paired.replace(BOX_FOOT, BOX_FOOT.replace("/>", ' name="left" contype="0" conaffinity="0"/>'))
    pairs = "".join(f'<pair geom1="{one}" geom2="{other}"/>' for one, other in (("floor", "left"), ("right", "floor")))
    paired = paired.replace("<worldbody>", f'<contact>{pairs}</contact><worldbody><geom name="floor" type="plane" size="1 1 1"/>')
    (tmp_path / "paired.xml").write_text(paired)
    assert cregopt.mujoco.robot(tmp_path / "paired.xml").to_dict()["sole"] == described["sole"]
    # Of a narrow heel and a wide toe, the heel counts.
    toes = "".join(f'<geom type="sphere" size="0.01" pos="{x} {y} -0.05" mass="0.1"/>' for x, w in ((-0.07, 0.03), (0.13, 0.04)) for y in (-w, w))
    (tmp_path / "toes.xml").write_text(human(toes))
    sole = cregopt.mujoco.robot(tmp_path / "toes.xml").to_dict()["sole"]
    assert (sole["length"], sole["width"]) == pytest.approx((0.2, 0.06))


def test_inverse_kinematics_attains_turned_soles(humanoid: pathlib.Path) -> None:
    machine = Machine(humanoid)
    yaws = (0.3, -0.2)
    soles = np.array([[[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]] for yaw in yaws])
    feet = machine.nominal_feet() + [[0.08, 0.02, 0.01], [-0.05, -0.01, 0.03]]
    missed, pose = machine.inverse_kinematics(np.zeros(3), np.eye(3), feet, soles)
    assert missed < 1e-6 and machine.within_ranges(pose)
    mujoco: Any = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(humanoid))
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    assert np.allclose(data.subtree_com[1], 0, atol=1e-5) and np.allclose(data.body("torso").xmat, np.eye(3).ravel())
    for f, side in enumerate(("left", "right")):
        foot = data.body(f"{side}_foot")
        assert np.allclose(foot.xmat.reshape(3, 3), soles[f], atol=1e-5)
        assert np.allclose(foot.xpos + soles[f] @ [0.03, 0, -0.06], feet[f], atol=1e-5)
    assert data.joint("arm").qpos[0] == 0 and data.joint("left_knee").qpos[0] > 0.1


def standing(robot: cregopt.Robot, x: float = 0.0, y: float = 0.0) -> dict[str, Any]:
    """Plan of standing for 2 s with the centre of mass at (x, y), which is the centre of pressure of the robot."""
    height, weight, left = robot.to_dict()["base_height"], 9.80665 * robot.mass, robot.nominal_feet[0, 1]

    def constant(value: "list[float]") -> dict[str, Any]:
        return {"poly_durations": [2.0], "nodes": [[*value, 0, 0, 0]] * 2}

    feet = []
    for side in (1, -1):
        force = weight * (1 + side * y / left) / 2
        # The pressure at (x, 0) from the centre of the sole.
        feet.append({"motion": constant([0, side * left, 0]), "force": constant([0, 0, force]), "moment": constant([0, -x * force, 0]), "yaws": [0.0]})
    return {
        "robot": robot.to_dict(),
        "terrain": "flat",
        "durations": [[2.0], [2.0]],
        "T": 2.0,
        "base_lin": constant([x, y, height]),
        "base_ang": constant([0, 0, 0]),
        "ee": feet,
        "init_base": [x, y, height],
        "base_target": [x, y, height],
        "yaw_target": 0,
    }


def test_a_urdf_file_gets_a_free_base_and_motors(tmp_path: pathlib.Path) -> None:
    text = (pathlib.Path(__file__).parents[1] / "data" / "humanoid.urdf").read_text()
    # A mesh that is not there.
    mesh = '<collision><geometry><mesh filename="package://humanoid/meshes/pelvis.stl"/></geometry></collision></link>'
    path = tmp_path / "human.urdf"
    path.write_text(text.replace("</link>", mesh, 1))
    machine = Machine(path)
    limits = {machine.model.joint(j).name: machine.torque_limits[j - 1] for j in range(1, machine.model.njnt)}
    assert machine.soled and machine.mass == pytest.approx(40) and [foot.name for foot in machine.feet] == ["L_foot", "R_foot"]
    assert (limits["L_yaw"], limits["R_knee"], limits["L_shoulder"]) == pytest.approx((40, 120, 30))
    report = cregopt.mujoco.play(standing(cregopt.mujoco.robot(path)), path, seed=1)
    assert report.followed and report.end_error < 0.002, str(report)


def test_a_humanoid_stands_on_its_soles(humanoid: pathlib.Path) -> None:
    robot = cregopt.mujoco.robot(humanoid)
    for x, y in ((0.0, 0.0), (0.06, 0.0), (-0.05, 0.04)):
        report = cregopt.mujoco.play(standing(robot, x, y), humanoid, seed=None if y else 2)
        assert report.followed and report.position_error_max < 0.02 and report.end_error < 0.002, f"{x} {y} {report}"
        assert report.slip_max < 0.005 and report.missing_contact < 0.02 and report.unsolved == 0
    # No pressure on the soles carries a centre of mass ahead of the toes.
    report = cregopt.mujoco.play(standing(robot, 0.13), humanoid)
    assert not report.followed, str(report)


@pytest.fixture(scope="module")
def turning_walk(humanoid: pathlib.Path) -> cregopt.Gait:
    task = cregopt.Task(cregopt.mujoco.robot(humanoid), cregopt.Terrain("flat", friction=0.8), goal=(0.5, 0.1), yaw=0.5)
    # Heavy legs cannot swing faster: the ankles do not carry their momentum.
    gait = cregopt.search(task, gaits="walk", first=True, device="cpu", settings={"transcription": {"foot_acceleration": 40}})
    assert gait.feasible
    return gait


def test_a_humanoid_walks_and_turns(turning_walk: cregopt.Gait, humanoid: pathlib.Path) -> None:
    for seed in (None, 1):
        report = cregopt.mujoco.play(turning_walk, humanoid, seed=seed)
        assert report.followed and report.position_error_max < 0.05 and report.end_error < 0.02, str(report)
        assert report.missing_contact < 0.15 and report.slip_max < 0.05 and report.unsolved == 0


def test_soles_follow_the_yaws_of_a_plan(turning_walk: cregopt.Gait, humanoid: pathlib.Path) -> None:
    plan, feet = _plan.read(turning_walk, 500), turning_walk.trajectory.to_dict()["ee"]
    for f, foot in enumerate(feet):
        assert plan.yaws[0, f] == foot["yaws"][0] and plan.yaws[-1, f] == pytest.approx(foot["yaws"][-1])
        # The sole is level and points ahead at its yaw; it turns in swings only.
        assert np.allclose(plan.sole(-1, f)[:, 0], [math.cos(foot["yaws"][-1]), math.sin(foot["yaws"][-1]), 0])
        still = plan.phases[:, f] % 2 == 0
        assert abs(plan.yaw_rates[2:-2, f][still[1:-3] & still[2:-2] & still[3:-1]]).max() < 1e-9 < abs(plan.yaw_rates[:, f]).max()
    ends: list[float] = []

    class Watched(Controller):
        def command(self, time: float, state: State, loads: Any) -> Any:
            if time > plan.horizon:
                ends[:] = [math.atan2(sole[1, 0], sole[0, 0]) for sole in state.soles] + [float(sole[2, 2]) for sole in state.soles]
            return super().command(time, state, loads)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cregopt.mujoco._play.Controller", Watched)
        assert cregopt.mujoco.play(turning_walk, humanoid).followed
    assert ends == pytest.approx([feet[0]["yaws"][-1], feet[1]["yaws"][-1], 1, 1], abs=0.05)


def test_a_foot_that_lifts_off_downhill_is_not_in_contact(humanoid: pathlib.Path) -> None:
    robot = cregopt.mujoco.robot(humanoid)
    x = np.arange(-2.0, 3.0, 0.25)
    terrain = cregopt.Terrain.heights(-0.25 * x[:, None] * np.ones((1, 16)), cell=0.25, origin=(-2.0, -2.0), friction=0.8)
    gait = cregopt.search(cregopt.Task(robot, terrain, goal=(0.6, 0.0)), gaits="walk", first=True, device="cpu", settings={"transcription": {"foot_acceleration": 40}})
    assert gait.feasible
    plan, machine = _plan.read(gait, 500), Machine(humanoid, count=2)
    controller = Controller(machine, plan, 0.8, 30.0, cregopt.mujoco.Gains())
    state = machine.state(machine.stance, np.zeros(machine.model.nv))
    descends = 0
    for k in range(len(plan.feet)):
        for f in map(int, np.flatnonzero(~plan.stands(k))):
            start, end = plan.edges[f][plan.phases[k, f] :][:2]
            share = (k * plan.step - start) / (end - start)
            # Loads of a foot that has just lifted off, and of one that lands early.
            touches = controller._touches(f, k, False, state._replace(feet=plan.feet[k]), 50.0)
            assert touches == (share > 0.5) or abs(share - 0.5) < 0.1, f"{f} {share}"
            descends += share < 0.3 and plan.feet_velocity[k, f, 2] < 0
    assert descends > 0
    report = cregopt.mujoco.play(gait, humanoid, seed=1)
    assert report.followed and report.position_error_max < 0.05, str(report)


def test_the_moments_of_a_plan_are_tracked(humanoid: pathlib.Path) -> None:
    robot = cregopt.mujoco.robot(humanoid)
    plan = standing(robot)
    # Opposite moments of the feet leave the motion as it is: the left foot presses on its toe, the right one on its heel.
    for foot, moment in zip(plan["ee"], (-4.0, 4.0)):
        foot["moment"]["nodes"] = [[0, moment, 0, 0, 0, 0]] * 2
    machine = Machine(humanoid, count=2)
    reference = _plan.read(plan, 500)
    assert np.allclose(reference.moments, [[0, -4, 0], [0, 4, 0]]) and not reference.yaws.any()
    controller = Controller(machine, reference, 0.8, 30.0, cregopt.mujoco.Gains())
    pose = machine.inverse_kinematics(reference.position[0], np.eye(3), reference.feet[0], np.array([reference.sole(0, f) for f in range(2)]))[1]
    state = machine.state(pose, np.zeros(machine.model.nv))
    command = controller.command(1.0, state, np.array([90.0, 90.0]))
    level = machine.model.joint
    ankles = [command.torque[level(f"{side}_ankle").dofadr[0] - 6] for side in ("left", "right")]
    # The joint carries the moment and that of the force, 0.03 m ahead of it.
    weight = 9.80665 * robot.mass / 2
    assert command.solved and ankles == pytest.approx([4.0 + 0.03 * weight, -4.0 + 0.03 * weight], abs=0.6)
    # The arm returns to its position in the stance.
    arm = level("arm").dofadr[0] - 6
    pose[arm + 7] = 0.2
    swung = controller.command(1.0, machine.state(pose, np.zeros(machine.model.nv)), np.array([90.0, 90.0]))
    assert abs(command.acceleration[arm]) < 0.1 and swung.acceleration[arm] == pytest.approx(-20, rel=0.05)


def test_plans_for_other_feet_are_rejected(humanoid: pathlib.Path, tmp_path: pathlib.Path) -> None:
    robot = cregopt.mujoco.robot(humanoid)
    plan = standing(robot)
    for foot in plan["ee"]:
        del foot["moment"], foot["yaws"]
    with pytest.raises(cregopt.Error, match=r"the robot `human` has soles|no yaws and moments"):
        cregopt.mujoco.play(plan, humanoid)
    del plan["robot"]["sole"]
    with pytest.raises(cregopt.Error, match="the feet of the plan are balls or points, those of the model human soles"):
        cregopt.mujoco.play(plan, humanoid)
    mixed = tmp_path / "mixed.xml"
    mixed.write_text(human().replace(BOX_FOOT, '<geom type="sphere" size="0.02" pos="0.03 0 -0.04" mass="0.4"/>', 1))
    with pytest.raises(cregopt.Error, match=r"some feet of the model mixed are soles, others are not: right_foot \(ball or point\), left_foot"):
        cregopt.mujoco.robot(mixed)


#: Settings of the planner for short drives.
TROT = {"families": ["trot"], "change_durations": False}
FORWARD = [((0.4, 0.0, 0.2), 1.5)]


def test_a_driven_robot_stays_upright_and_reports_it(model: pathlib.Path) -> None:
    commands = [((0.4, 0.0, 0.3), 1.9), ((0.0, 0.1, 0.0), 0.1)]
    report = cregopt.mujoco.drive(model, commands, pushes=[(0.2, (0.0, 40.0, 0.0), 0.1)], settings=TROT)
    assert report.upright and report.fall is None and report.fall_time is None, str(report)
    assert (report.model, report.rate, report.delay) == ("small", 50.0, 0.0) and report.seconds == pytest.approx(2.0)
    assert report.mass == pytest.approx(12.2) and report.friction == cregopt.Terrain("flat").friction
    assert report.commands == [[0.4, 0.0, 0.3, 1.9], [0.0, 0.1, 0.0, 0.1]] and report.pushes == [[0.2, 0.0, 40.0, 0.0, 0.1]]
    assert not report.noise and not report.open_loop and report.seed is None and report.notes == []
    assert report.updates == 100 and 0 <= report.kept < 80 and 0 <= report.late <= 100
    assert 0 < report.ms_median <= report.ms_99
    assert report.gaits[0][0] == 0.0 and {gait for _, gait in report.gaits} <= {"trot", "stand"}
    # Accelerates to 0.4 m/s and holds it.
    assert 0.4 < report.distance < 0.9
    assert report.speed_command_rms == pytest.approx(0.4) and report.speed_error_rms < 0.2 and report.turn_error_rms < 0.3
    assert 0.1 < report.torque_share <= 1 and 1 < report.joint_speed < report.joint_speed_limit
    assert report.to_dict()["gaits"] == report.gaits and "upright to the end" in str(report)


def without_durations(report: cregopt.mujoco.DriveReport) -> dict[str, Any]:
    """Report without the values that depend on the speed of the machine."""
    return {key: value for key, value in report.to_dict().items() if key not in ("ms_median", "ms_99", "late")}


def test_a_humanoid_is_driven_on_its_soles(humanoid: pathlib.Path) -> None:
    commands = [((0.0, 0.0, 0.0), 0.5), ((0.2, 0.0, 0.2), 3.0)]
    report = cregopt.mujoco.drive(humanoid, commands, pushes=[(2.0, (0.0, 60.0, 0.0), 0.1)])
    assert report.upright and report.kept < 10, report
    assert any(gait == "walk" for _, gait in report.gaits) and report.distance > 0.2


def test_drives_with_noise_and_delay_are_reproducible(model: pathlib.Path) -> None:
    drives = [cregopt.mujoco.drive(model, [((0.3, 0.0, 0.0), 0.6)], settings=TROT, noise=True, delay=0.02, seed=seed) for seed in (None, None, 3)]
    once, again, other = (without_durations(drive) for drive in drives)
    assert once["upright"] and other["upright"]
    assert once == again != other
    assert once["noise"] and once["delay"] == 0.02 and other["friction"] != 0.8


def test_a_robot_in_open_loop_follows_its_plans(model: pathlib.Path) -> None:
    report = cregopt.mujoco.drive(model, FORWARD, settings=TROT, open_loop=True)
    assert report.upright and report.open_loop and report.distance > 0.3, str(report)


def test_a_strong_push_topples_a_driven_robot(model: pathlib.Path) -> None:
    report = cregopt.mujoco.drive(model, FORWARD, pushes=[(0.2, (0.0, 900.0, 300.0), 0.2)], settings=TROT)
    assert not report.upright and report.fall and report.fall_time is not None and 0.2 < report.fall_time < 1.5
    assert f"falls at {report.fall_time:.2f} s" in str(report)


def test_feet_of_a_given_robot_are_assigned_to_those_of_the_model(model: pathlib.Path) -> None:
    made = cregopt.mujoco.robot(model)
    described = made.to_dict()
    described["nominal_feet"] = described["nominal_feet"][::-1]
    reverse = cregopt.Robot.from_dict(described)
    assert np.array_equal(reverse.nominal_feet, made.nominal_feet[::-1])
    report = cregopt.mujoco.drive(model, [((0.3, 0.0, 0.0), 0.5)], robot=reverse, settings=TROT)
    assert report.upright, str(report)
    heavy = cregopt.Robot.from_dict({**made.to_dict(), "mass": 13.0})
    report = cregopt.mujoco.drive(model, [((0.0, 0.0, 0.0), 0.1)], robot=heavy, settings=TROT)
    assert report.notes == ["the planner's robot weighs 13 kg, the model 12.2 kg"]


def test_a_robot_starts_above_ground_that_the_planner_does_not_know(model: pathlib.Path) -> None:
    raised = cregopt.Terrain.heights(np.full((81, 81), 0.05), cell=0.1, origin=(-4, -4))
    report = cregopt.mujoco.drive(model, [((0.0, 0.0, 0.0), 0.3)], ground=raised, settings=TROT)
    assert report.upright and report.joint_speed < 5, str(report)


@pytest.mark.parametrize("height, settings", [(0.06, {}), (0.05, TROT)])
def test_a_driven_robot_goes_down_a_step_that_the_planner_does_not_know(model: pathlib.Path, height: float, settings: dict[str, Any]) -> None:
    rows = -4 + 0.025 * np.arange(321)
    step = cregopt.Terrain.heights(np.repeat(np.where(rows < 0.35, 0.0, -height)[:, None], 321, axis=1), cell=0.025, origin=(-4, -4))
    report = cregopt.mujoco.drive(model, [((0.4, 0.0, 0.0), 3.0)], ground=step, settings=settings)
    # All feet are below: the step is 0.15 m in front of the front feet.
    assert report.upright and report.distance > 0.8, str(report)


def test_a_driven_robot_bears_a_load_that_it_does_not_know(model: pathlib.Path) -> None:
    stands, loads = [((0.0, 0.0, 0.0), 1.5)], [(3.0, (0.0, y)) for y in (-0.105, -0.11, 0.115)]
    learns, ignores = (
        [cregopt.mujoco.drive(model, stands, load=load, settings=TROT, gains=gains) for load in loads] for gains in (None, cregopt.mujoco.Gains(capture=0.0))
    )
    assert learns[0].load == [3.0, 0.0, -0.105], str(learns[0])
    for learnt, ignored in zip(learns, ignores):
        # The feet of a robot that ignores the load move it away from its place.
        assert learnt.upright and learnt.distance < 0.08 and learnt.distance < 0.5 * ignored.distance, f"{learnt}\n{ignored}"
    light = cregopt.mujoco.drive(model, stands, settings=TROT)
    assert light.load is None and light.torque_share < min(report.torque_share for report in learns)


def test_the_ground_is_that_of_the_plan() -> None:
    mujoco: Any = pytest.importorskip("mujoco")
    feet = np.array([[[0.013, -0.1, 0.0], [1.1, 0.1, 0.0]]])
    n = np.arange(160)
    riser, ridge, sharp, slope = np.where(n >= 63, 0.1, 0.0), np.maximum(0.1 - 0.02 * abs(n - 63), 0), np.maximum(0.1 - 0.05 * abs(n - 63), 0), 0.0067 * n
    block = riser[:, None] * (np.arange(90) > 40)
    terrains = [cregopt.Terrain(name) for name in ("stairs", "slope", "block", "gap", "chimney")]
    for heights in (riser, ridge, slope, sharp, block):
        grid = heights if heights.ndim == 2 else heights[:, None] * np.ones(90)
        terrains.append(cregopt.Terrain.heights(grid, cell=0.025, origin=(-1.0, -1.003)))
    for terrain in terrains:
        # Boxes below the sides of a sharp ridge would come out on its other side.
        strips = terrain.name not in ("gap", "chimney") and terrain not in terrains[-2:]
        for patches in ([], [(0.3, 0.4, 0.52)]):
            spec = mujoco.MjSpec()
            names = _ground.add(spec, terrain, 0.8, feet, patches)
            model = spec.compile()
            data, hit = mujoco.MjData(model), np.zeros(1, dtype=np.int32)
            mujoco.mj_forward(model, data)
            kinds = {int(model.geom(name).type[0]) for name in names}
            assert kinds == {int(mujoco.mjtGeom.mjGEOM_BOX if strips else mujoco.mjtGeom.mjGEOM_HFIELD)}, terrain.name
            for x, y in itertools.product(np.linspace(-0.5, 1.6, 1051), (-0.3, 0.2)):
                depth = mujoco.mj_ray(model, data, np.array([x, y, 3.0]), np.array([0.0, 0.0, -1.0]), None, 1, -1, hit)
                # Heights within a small distance: vertical edges have no height, and height fields are interpolated.
                near = 1e-3 if strips else 0.05
                beside = [max(terrain.height(x + dx, y + dy), -_ground.DEPTH) for dx in (-near, 0.0, near) for dy in (-near, 0.0, near)]
                rounded = 1e-5 if strips else 0.03
                assert min(beside) - rounded <= 3.0 - depth <= max(beside) + rounded, f"{terrain.name} {x} {y}: {3 - depth}, {beside}"


def test_a_sole_has_all_its_contacts_on_a_grid() -> None:
    mujoco: Any = pytest.importorskip("mujoco")
    rise = np.maximum(np.arange(-80, 80) * 0.025, 0.0) * 0.25
    for cell in (0.025, 0.005):
        terrain = cregopt.Terrain.heights(rise[:, None] * np.ones(160), cell=cell, origin=(-80 * cell, -80 * cell))
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(pos=[-0.15, 0.0, 0.0])
        body.add_freejoint()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.105, 0.065, 0.01], mass=1.0)
        _ground.add(spec, terrain, 0.8, np.zeros((1, 1, 3)))
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[2] = 0.0099
        mujoco.mj_forward(model, data)
        at = np.array([contact.pos[:2] for contact in data.contact]) - data.qpos[:2]
        for corner in itertools.product((-0.105, 0.105), (-0.065, 0.065)):
            assert np.linalg.norm(at - corner, axis=1).min() < 1e-3, f"{cell}: {at}"


def test_patches_have_their_own_friction(model: pathlib.Path) -> None:
    robot, pushes = cregopt.mujoco.robot(model), [(0.2, (0.0, 60.0, 0.0), 0.2)]
    stands = [((0.0, 0.0, 0.0), 1.0)]
    patch = [(0.02, -0.5, 0.5)]
    rough, smooth = (cregopt.mujoco.drive(model, stands, robot=robot, pushes=pushes, patches=patches, settings=TROT) for patches in ([], patch))
    assert smooth.patches == [[0.02, -0.5, 0.5]] and rough.patches == []
    assert rough.upright and not smooth.upright, f"{rough}\n{smooth}"
    feet = np.array([[[-1.0, -1.0, 0.0], [2.0, 1.0, 0.0]]])
    for terrain in (cregopt.Terrain("flat"), cregopt.Terrain.heights(np.zeros((9, 9)), cell=1.0, origin=(-4, -4))):
        spec = Machine(model).spec
        names = _ground.add(spec, terrain, 0.8, feet, [(0.3, 0.5, 1.0), (0.4, 1.0, 9.0)])
        geoms = [spec.compile().geom(name) for name in names]
        assert [float(geom.friction[0]) for geom in geoms] == [0.8, 0.3, 0.4, 0.8][: len(geoms)]
        assert 0.5 < float(geoms[1].pos[0]) < 1.0


def test_bad_arguments_of_drives_are_rejected(model: pathlib.Path) -> None:
    nan = float("nan")
    cases: list[tuple[dict[str, Any], str]] = [
        ({"commands": []}, "commands: there must be at least one"),
        ({"commands": [((0.1, 0.0, 0.0), 1.0), ((nan, 0.0, 0.0), 1.0)]}, r"commands\[1\]: "),
        ({"commands": [((0.1, 0.0, 0.0), 0.0)]}, r"commands\[0\]: .* positive duration"),
        ({"commands": [((99.0, 0.0, 0.0), 1.0)]}, r"command\.velocity\[0\]: 99"),
        ({"pushes": [(1.0, (nan, 0.0, 0.0), 0.1)]}, r"pushes\[0\]: "),
        ({"rate": 0.5}, "rate 0.5: must be between 1 and 500 Hz"),
        ({"delay": 0.6}, "delay 0.6: must be between 0 and 0.5 s"),
        ({"settings": {"latency": 0.1}}, "settings: the latency is given by the delay"),
        ({"settings": {"horizn": 1}}, "settings: horizn: unknown field"),
        ({"speed_limit": 0.0}, "speed limit 0.0"),
        ({"friction": -1.0}, "friction -1.0"),
        ({"seed": -1}, "seed -1"),
        ({"patches": [(0.3, 1.0, 0.5)]}, r"patches\[0\]: "),
        ({"patches": [(0.0, 0.5, 1.0)]}, r"patches\[0\]: .* positive friction"),
        ({"patches": [(0.3, 0.5, 2.0), (0.3, 0.0, 1.0)]}, r"patches\[0\]: it begins at 0.5 m, but another patch ends at 1 m"),
        ({"load": (-1.0, (0.0, 0.0))}, r"load \(-1.0, "),
        ({"load": (1.0, (nan, 0.0))}, r"load \(1.0, "),
        ({"feet": ["FL", "FR", "RL"], "robot": cregopt.Robot("anymal")}, "the robot has 4 feet, the model small 3"),
        ({"video": "film.avi"}, r"film\.avi: an animation is one of"),
    ]
    for changed, message in cases:
        with pytest.raises(cregopt.Error, match=message):
            cregopt.mujoco.drive(model, **{"commands": FORWARD, **changed})
    for seconds, seed in ((nan, 0), (0.0, 0), (math.inf, 0), (5.0, -1)):
        with pytest.raises(cregopt.Error):
            cregopt.mujoco.random_drive(seconds, seed, 12.0, 0.3)


def test_random_drives_are_deterministic_and_within_their_limits() -> None:
    commands, pushes = cregopt.mujoco.random_drive(20.0, 7, 12.0, 0.3)
    assert (commands, pushes) == cregopt.mujoco.random_drive(20.0, 7, 12.0, 0.3)
    assert (commands, pushes) != cregopt.mujoco.random_drive(20.0, 8, 12.0, 0.3)
    assert commands[0] == ((0.0, 0.0, 0.0), 0.5)
    assert 20 <= sum(seconds for _, seconds in commands) < 25
    speed = math.sqrt(9.80665 * 0.3)
    for (forward, left, turn), seconds in commands[1:]:
        assert -0.09 * speed <= forward <= 0.3 * speed and abs(left) <= 0.15 * speed and abs(turn) <= 0.6 and 2 <= seconds <= 5
    assert len(pushes) >= 3
    for time, force, seconds in pushes:
        assert 2 <= time < 19 and force[2] == 0 and np.linalg.norm(force) * seconds <= 0.35 * 12.0 + 1e-9


def run(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([sys.executable, "-m", "cregopt.mujoco", *arguments], capture_output=True, text=True, timeout=120)


def main(arguments: list[str]) -> tuple[int, str]:
    """Exit code and errors of a command line, without another process."""
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors):
        code = cregopt.mujoco.__main__.main(arguments)
    return code, errors.getvalue()


def test_the_command_line_plays_plans_and_writes_robots(trot: cregopt.Gait, model: pathlib.Path, tmp_path: pathlib.Path) -> None:
    trot.trajectory.save(tmp_path / "trajectory.json")
    plan, robot = str(tmp_path / "trajectory.json"), tmp_path / "robot.toml"
    played = run(plan, "--model", str(model), "--json", "--friction", "0.8")
    assert played.returncode == 0, played.stderr
    report: dict[str, Any] = json.loads(played.stdout)
    assert report["upright"] and report["followed"] and report["friction"] == 0.8
    (tmp_path / "bound.json").write_text(json.dumps(swapped(trot.trajectory.to_dict(), trot.task.robot, 1, 3)))
    fallen = run(str(tmp_path / "bound.json"), "--model", str(model))
    assert fallen.returncode == 3 and "falls at" in fallen.stdout, fallen.stdout + fallen.stderr
    assert run("--model", str(model), "--robot", str(robot)).returncode == 0
    assert cregopt.Robot.from_file(robot) == cregopt.mujoco.robot(model)
    (tmp_path / "hyq.xml").write_text(model.read_text())
    assert cregopt.mujoco.robot(tmp_path / "hyq.xml").name == "hyq-imported"
    missing = run("nowhere.json", "--model", str(model))
    assert missing.returncode == 4 and missing.stderr.startswith("error: ") and "nowhere.json" in missing.stderr
    assert run("--model", str(model)).returncode == 2


def test_the_command_line_drives_robots(model: pathlib.Path) -> None:
    quick = ["--model", str(model), "--gait", "trot"]
    driven = run("drive", *quick, "--command", "0.3,0,0:0.5;0,0,0.2:0.3", "--push", "0.2:0,30,0:0.1", "--set", "horizon=0.7", "--load", "1:0,0.1", "--patch", "0.5:0.2,1;0.4:1,2", "--json")
    assert driven.returncode == 0, driven.stderr
    report: dict[str, Any] = json.loads(driven.stdout)
    assert report["upright"] and report["seconds"] == pytest.approx(0.8)
    assert report["commands"] == [[0.3, 0, 0, 0.5], [0, 0, 0.2, 0.3]] and report["pushes"] == [[0.2, 0, 30, 0, 0.1]]
    assert report["load"] == [1, 0, 0.1] and report["patches"] == [[0.5, 0.2, 1], [0.4, 1, 2]]
    fallen = run("drive", *quick, "--command", "0,0,0:1.5", "--push", "0:0,900,300:0.2")
    assert fallen.returncode == 3 and "falls at" in fallen.stdout, fallen.stdout + fallen.stderr
    cases = [
        (["--command", "fast"], "--command 'fast': must be N,N,N:N"),
        (["--command", "0,0,0:0"], "commands[0]: "),
        (["--push", "1:0,0:1"], "--push '1:0,0:1': must be N:N,N,N:N"),
        (["--patch", "0.3:1"], "--patch '0.3:1': must be N:N,N"),
        (["--load", "3"], "--load '3': must be N:N,N"),
        (["--set", "horizon"], "--set 'horizon': must be KEY=VALUE"),
        (["--set", "horizon=99"], "planner.horizon: 99"),
        (["--gait", "stroll"], "settings: families[0]: unknown variant `stroll`"),
        (["--random", "-1"], "random commands for -1.0 s"),
        (["--rate", "1000"], "rate 1000.0"),
        (["--terrain", "nowhere.json"], "nowhere.json"),
        (["--robot", "nowhere.toml"], "nowhere.toml"),
        (["--model", "nowhere.xml"], "nowhere.xml: there is no such model file"),
    ]
    for arguments, message in cases:
        bad = main(["drive", *quick, *arguments])
        assert bad[0] == 4 and bad[1].startswith("error: ") and message in bad[1], (arguments, bad)
    assert run("drive", *quick, "--random", "1", "--command", "0,0,0:1").returncode == 2
    assert run("drive").returncode == 2


def test_without_mujoco_the_error_names_the_package_to_install(model: pathlib.Path) -> None:
    code = "import sys; sys.modules['mujoco'] = None\nfrom cregopt.mujoco.__main__ import main\nsys.exit(main(sys.argv[1:]))"
    arguments = [sys.executable, "-c", code, "--model", str(model), "--robot", "robot.json"]
    run = subprocess.run(arguments, capture_output=True, text=True, timeout=120)
    assert run.returncode == 4 and run.stderr.startswith("error: cregopt.mujoco needs mujoco"), run.stderr
    assert run.stderr.endswith("pip install cregopt[mujoco]\n")


def test_the_example_stays_upright(run_example: Callable[..., str], model: pathlib.Path) -> None:
    assert "upright to the end" in run_example("play_in_mujoco", str(model))
