"""Robots from MJCF files, compared with the models that MuJoCo makes of them."""

import pathlib
from typing import Any

import cregopt
import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")

#: Leg with solids of several kinds, a frame, several joints per body with anchors and references, and a joint that follows another.
LEG = """
<frame pos="0.1 {y} 0" quat="0.9 0.1 0.2 0.3">
  <body name="{leg}_thigh" pos="0 0 -0.1" xyaxes="1 0.2 0 0 1 0.3" childclass="limb">
    <joint name="{leg}_yaw" axis="0 0 1" pos="0.01 0 0" range="-1 1"/>
    <joint name="{leg}_roll" axis="1 0 0.2" pos="0 0.02 0" range="-1 1"/>
    <joint name="{leg}_pitch" pos="0 0 0.03" ref="0.3" range="-1 2"/>
    <geom fromto="0 0 0 0.05 0 -0.3"/>
    <body name="{leg}_shank" pos="0.05 0 -0.3" axisangle="0 1 0.1 0.7">
      <joint name="{leg}_knee" range="-2.5 -0.1" actuatorfrcrange="-30 30"/>
      <geom fromto="0 0 0 0 0 -0.3" mass="1.2"/>
      <geom class="tip" pos="0 0 -0.3" zaxis="1 0 1"/>
      <body name="{leg}_toe" pos="0 0 -0.3">
        <joint name="{leg}_spring" type="slide" axis="0 0 1" range="-0.1 0.1"/>
        <geom type="sphere" size="0.03"/>
      </body>
    </body>
  </body>
</frame>"""
COUPLING = '<joint joint1="{leg}_spring" joint2="{leg}_knee" polycoef="0.01 0.02 0 0 0"/>'
MOTORS = '<motor joint="{leg}_knee" gear="20" ctrlrange="-2 2"/><position joint="{leg}_pitch" forcerange="-50 40"/>'
POSTURE = {"L_yaw": 0.1, "L_roll": -0.2, "L_pitch": 0.5, "L_knee": -1.1, "R_yaw": 0.3, "R_roll": 0.1, "R_pitch": 0.4, "R_knee": -0.9}


def both(element: str) -> str:
    """An element for the left and the right leg."""
    return element.format(leg="L", y=0.2) + element.format(leg="R", y=-0.2)


def mixed() -> str:
    """A biped with three kinds of orientation, beside a table; its total mass is set, and a geom is in a group without mass."""
    return f"""
<mujoco model="mixed">
  <compiler angle="radian" settotalmass="21" inertiagrouprange="0 2" eulerseq="XZy"/>
  <default>
    <default class="limb"><geom type="capsule" size="0.03" density="700"/><joint axis="0 1 0"/></default>
    <default class="tip"><geom type="ellipsoid" size="0.05 0.03 0.02" group="1"/></default>
  </default>
  <worldbody>
    <body name="trunk" pos="0 0 1" euler="0.1 0.2 0.3">
      <freejoint/>
      <geom type="cylinder" size="0.1 0.2" euler="0.4 0.1 -0.2"/>
      <geom type="box" size="0.1" fromto="0 0 0 0.2 0.1 0.3"/>
      <geom size="0.1" mass="3" group="3"/>{both(LEG)}
    </body>
    <geom name="table" type="box" size="1 1 0.1"/>
  </worldbody>
  <equality>{both(COUPLING)}</equality>
  <actuator>{both(MOTORS)}</actuator>
</mujoco>"""


def compare(robot: cregopt.Robot, model: Any, base: str) -> None:
    """Compares mass, inertia, feet and joints with a model of MuJoCo in the same posture."""
    found = robot.imported
    assert found is not None
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[model.body(base).jntadr[0]] :][:7] = 0, 0, 0, 1, 0, 0, 0
    for joint, value in found["configuration"].items():
        data.qpos[model.joint(joint).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    bodies = [b for b in range(model.nbody) if model.body_rootid[b] == model.body(base).id]
    center = model.body_mass[bodies] @ data.xipos[bodies] / model.body_mass[bodies].sum()
    inertia = np.zeros((3, 3))
    for b in bodies:
        axes, offset = data.ximat[b].reshape(3, 3), data.xipos[b] - center
        inertia += axes * model.body_inertia[b] @ axes.T + model.body_mass[b] * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    assert robot.mass == pytest.approx(model.body_mass[bodies].sum(), rel=1e-12)
    assert found["center_of_mass"] == pytest.approx(center, abs=1e-12)
    assert np.array(robot.to_dict()["inertia"]) == pytest.approx(inertia, abs=1e-12)
    for foot in found["feet"]:
        assert foot["frame"] == pytest.approx(data.body(foot["link"]).xpos - center, abs=1e-12)
    for joint in (joint for leg in robot.to_dict()["joints"] for joint in leg["chain"]):
        assert [joint["lower"], joint["upper"]] == pytest.approx(model.joint(joint["name"]).range)


def test_every_kind_of_element_is_read_as_by_mujoco() -> None:
    model = mujoco.MjModel.from_xml_string(mixed())
    robot = cregopt.Robot.from_mjcf(mixed(), feet=["L_shank", "R_shank"], configuration=POSTURE)
    compare(robot, model, "trunk")
    # A follower keeps its polynomial of the other joint.
    assert robot.imported is not None and robot.imported["configuration"]["L_spring"] == pytest.approx(0.01 + 0.02 * POSTURE["L_knee"])
    for leg in robot.to_dict()["joints"]:
        assert [joint.get("effort") for joint in leg["chain"]] == [None, None, 50, 30]


def test_a_file_stands_as_in_its_keyframe(tmp_path: pathlib.Path) -> None:
    path = pathlib.Path(__file__).parents[1] / "data" / "quadruped.xml"
    model = mujoco.MjModel.from_xml_path(str(path))
    robot = cregopt.Robot.from_mjcf(path)
    compare(robot, model, "base")
    assert robot == cregopt.Robot.from_mjcf(path.read_text()) and robot.imported is not None
    values = robot.imported["configuration"]
    assert [values[joint] for joint in values] == pytest.approx(list(model.key("home").qpos[14:]))
    scene = tmp_path / "scene.xml"
    scene.write_text(f'<mujoco><include file="{path}"/></mujoco>')
    assert cregopt.Robot.from_mjcf(scene, name="four") == robot
    with pytest.raises(cregopt.Error, match="scene.xml: feet: `LF_fot`.*`LF_foot`"):
        cregopt.Robot.from_mjcf(scene, feet=["LF_fot"])
    with pytest.raises(cregopt.Error, match="outermost element: <mujoco>, but it must be <robot>"):
        cregopt.Robot.from_urdf(path.read_text())
