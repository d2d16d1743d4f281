"""Robots from URDF files, and joint angles of motions."""

import json
import pathlib
import subprocess
from typing import Any

import cregopt
import numpy as np
import pytest
from numpy.typing import NDArray

URDF = pathlib.Path(__file__).parents[1] / "data/quadruped.urdf"
LEGS = ["LF", "RF", "LH", "RH"]
STANDING = {f"{leg}_{joint}": value for leg in LEGS for joint, value in (("pitch", 0.785), ("knee", -1.57))}
Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def robot() -> cregopt.Robot:
    return cregopt.Robot.from_urdf(URDF, configuration=STANDING)


@pytest.fixture(scope="module")
def walk(robot: cregopt.Robot) -> cregopt.Gait:
    task = cregopt.Task(robot, cregopt.Terrain("flat"), goal=(0.5, 0.1), yaw=0.3)
    return cregopt.search(task, first=True, threads=1, device="cpu")


def turn(axis: int, angles: Floats) -> Floats:
    """Rotation matrices about a coordinate axis, shape (n, 3, 3), of angles in rad, shape (n,)."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turned = np.zeros((len(angles), 3, 3))
    turned[:, axis, axis] = 1.0
    turned[:, a, a] = turned[:, b, b] = np.cos(angles)
    turned[:, b, a] = np.sin(angles)
    turned[:, a, b] = -np.sin(angles)
    return turned


def tip(leg: int, q: Floats, center: Floats) -> Floats:
    """Centre of a foot ball relative to the centre of mass, base frame, m, shape (n, 3), from joint angles q, shape (n, 3), by the URDF."""
    hip = np.array([0.2 if leg < 2 else -0.2, 0.15 if leg % 2 == 0 else -0.15, 0.0]) - center
    link = np.array([0.0, 0.0, -0.25])
    hanging = turn(1, q[:, 1]) @ (link + turn(1, q[:, 2]) @ link)[:, :, None]
    return np.asarray(hip + (turn(0, q[:, 0]) @ hanging)[:, :, 0])


def test_an_imported_robot_matches_its_urdf(robot: cregopt.Robot) -> None:
    assert (robot.name, robot.feet) == ("four", 4) and robot.mass == pytest.approx(10.0 + 8 * 0.4)
    found = robot.imported
    assert found is not None and [foot["link"] for foot in found["feet"]] == [f"{leg}_foot" for leg in LEGS]
    assert {name: found["configuration"][name] for name in STANDING} == STANDING and len(found["configuration"]) == 12
    assert any("feet were not named" in note for note in found["notes"]) and found["foot_speed"] > 0
    # A foot is a ball around the origin of its link.
    down = [0.0, 0.0, robot.to_dict()["foot_radius"]]
    assert robot.nominal_feet == pytest.approx(np.array([foot["frame"] for foot in found["feet"]]) - down)
    assert down[2] == 0.02
    for leg in range(4):
        joints = np.array([[0.0, 0.785, -1.57]])
        assert tip(leg, joints, np.array(found["center_of_mass"]))[0] - down == pytest.approx(robot.nominal_feet[leg])
    assert cregopt.Robot("anymal").imported is None


def test_a_urdf_can_be_given_as_text_with_feet_and_a_name(robot: cregopt.Robot, tmp_path: pathlib.Path) -> None:
    text = URDF.read_text()
    assert cregopt.Robot.from_urdf(text, configuration=STANDING) == robot == cregopt.Robot.from_urdf(str(URDF), None, STANDING)
    assert cregopt.Robot.from_urdf("\ufeff\n " + text[text.index("<robot") :], configuration=STANDING) == robot
    turned = cregopt.Robot.from_urdf(text, feet=["RF_foot", "LF_foot", "LH_foot", "RH_foot"], configuration=STANDING, name="other")
    assert turned.name == "other" and turned.nominal_feet[[1, 0, 2, 3]] == pytest.approx(robot.nominal_feet)
    bent = cregopt.Robot.from_urdf(URDF)
    assert bent.imported is not None and any("legs are bent" in note for note in bent.imported["notes"])
    for name in ("own.toml", "own.json"):
        robot.save(tmp_path / name)
        assert cregopt.Robot.from_file(tmp_path / name) == robot == cregopt.Robot(str(tmp_path / name))
    assert cregopt.Robot.from_dict(robot.to_dict()) == robot


def test_the_program_imports_the_same_robot(robot: cregopt.Robot, program: str) -> None:
    configuration = ",".join(f"{name}={value}" for name, value in STANDING.items())
    command = [program, "robot", "import", str(URDF), "--configuration", configuration]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout
    assert json.loads(printed) == robot.to_dict()
    wrong = [program, "robot", "import", str(URDF), "--configuration", "LF_knee=0"]
    message = subprocess.run(wrong, capture_output=True, text=True, timeout=60).stderr
    with pytest.raises(cregopt.Error) as raised:
        cregopt.Robot.from_urdf(URDF, configuration={"LF_knee": 0.0})
    assert message == f"error: {raised.value}\n"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"feet": ["LF_fot"]}, "quadruped.urdf: feet: `LF_fot`.*`LF_foot`"),
        ({"feet": ["LF_foot"] * 2}, "`LF_foot`, but it must be named once"),
        ({"configuration": {"LF_knee": 0.0}}, "joint `LF_knee`: 0, but it must be within its limits, -2.5 to -0.5"),
        ({"configuration": {"LF_knee": float("nan")}}, "joint `LF_knee`: NaN"),
        ({"configuration": {"LF_elbow": 1.0}}, "configuration: `LF_elbow`"),
        ({"configuration": {"LF_knee": "bent"}}, "configuration: .*bent.*, but it must be values of joints by their names"),
        ({"name": "x" * 1000}, "robot.name"),
    ],
)
def test_errors_name_invalid_import_options(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(cregopt.Error, match=sentence):
        cregopt.Robot.from_urdf(URDF, **options)


def test_errors_name_files_that_are_not_urdf(tmp_path: pathlib.Path) -> None:
    with pytest.raises(FileNotFoundError, match="cannot read .*none.urdf"):
        cregopt.Robot.from_urdf(tmp_path / "none.urdf")
    (tmp_path / "half.urdf").write_text(URDF.read_text()[:700])
    with pytest.raises(cregopt.Error, match="half.urdf: .*XML"):
        cregopt.Robot.from_urdf(tmp_path / "half.urdf")
    with pytest.raises(cregopt.Error, match="XML"):
        cregopt.Robot.from_urdf("<robot")
    with pytest.raises(TypeError):
        cregopt.Robot.from_urdf(3)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        cregopt.Robot.from_urdf(URDF, feet="LF_foot")


def test_joint_angles_put_the_feet_at_their_planned_positions(walk: cregopt.Gait, robot: cregopt.Robot) -> None:
    joints, motion = walk.joints(rate=400), walk.sample(rate=400)
    n = len(motion)
    assert walk.feasible and len(joints) == n and joints.time.tolist() == motion.time.tolist()
    assert joints.names == [f"{leg}_{joint}" for leg in LEGS for joint in ("roll", "pitch", "knee")]
    assert joints.turns.dtype == np.bool_ and joints.turns.tolist() == [True] * 12
    for array in (joints.positions, joints.velocities, joints.efforts):
        assert array.shape == (n, 12) and array.dtype == np.float64 and np.isfinite(array).all()
    assert joints.positions[0] == pytest.approx([0.0, 0.785, -1.57] * 4, abs=1e-4)
    found = robot.imported
    assert found is not None
    center = np.array(found["center_of_mass"])
    roll, pitch, yaw = motion.base_angles.T
    to_world = turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
    for leg in range(4):
        q = joints.positions[:, 3 * leg : 3 * leg + 3]
        place = motion.base_position + (to_world @ tip(leg, q, center)[:, :, None])[:, :, 0] - [0.0, 0.0, 0.02]
        assert np.linalg.norm(place - motion.feet_position[:, leg], axis=1).max() < 1e-4
        # Principle of virtual work: the joint efforts balance the contact force.
        force = (to_world.transpose(0, 2, 1) @ motion.forces[:, leg, :, None])[:, :, 0]
        contact = -0.02 * to_world[:, 2, :]
        for j in range(3):
            step = np.eye(3)[j] * 1e-6
            moved = (tip(leg, q + step, center) - tip(leg, q - step, center)) / 2e-6
            # The contact point is below the centre of the ball, and moves with the last link.
            axis = [turn(0, q[:, 0])[:, :, 0] * 0 + [1.0, 0.0, 0.0], turn(0, q[:, 0])[:, :, 1], turn(0, q[:, 0])[:, :, 1]][j]
            lever = moved + np.cross(axis, contact)
            assert joints.efforts[:, 3 * leg + j] == pytest.approx(-(force * lever).sum(axis=1), abs=0.02)
    # Away from lift-offs and touchdowns, velocities are the derivatives of positions.
    slopes = np.gradient(joints.positions, joints.time, axis=0)
    steady = np.ones(n, dtype=bool)
    changes = np.flatnonzero((motion.contacts[1:] != motion.contacts[:-1]).any(axis=1))
    for near in range(-2, 4):
        steady[np.clip(changes + near, 0, n - 1)] = False
    steady[[0, -1, -2]] = False
    assert steady.sum() > n / 4
    assert np.abs(slopes - joints.velocities)[steady].max() < 0.2


def test_limits_report_the_worst_instant_of_a_motion(walk: cregopt.Gait, robot: cregopt.Robot, program: str, tmp_path: pathlib.Path) -> None:
    joints = walk.joints()
    limits = joints.limits
    assert joints.kept == limits["kept"] and f"{len(joints)} instants, 12 joints" in repr(joints)
    for name, array, limit in (("velocity", joints.velocities, 12.0), ("effort", joints.efforts, 30.0)):
        worst = limits[name]
        row = np.flatnonzero(joints.time == worst["time"])[0]
        assert array[row, joints.names.index(worst["name"])] == worst["value"] and worst["limit"] == limit
        assert np.abs(array).max() == abs(worst["value"])
    walk.save(tmp_path)
    command = [program, "robot", "joints", str(tmp_path / "trajectory.json"), "--json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert json.loads(run.stdout) == limits and run.returncode == (0 if joints.kept else 3)
    assert walk.trajectory.joints().positions.tolist() == joints.positions.tolist()
    # Weaker motors on the same legs.
    weak = robot.to_dict()
    for leg in weak["joints"]:
        for joint in leg["chain"]:
            joint["effort"] = 0.9 * abs(limits["effort"]["value"])
    beyond = walk.joints(robot=cregopt.Robot.from_dict({**weak, "name": "weak"}))
    assert not beyond.kept and abs(beyond.limits["effort"]["value"]) > beyond.limits["effort"]["limit"]


def test_joints_of_a_robot_without_a_joint_model_are_an_error(gait: cregopt.Gait, walk: cregopt.Gait) -> None:
    with pytest.raises(cregopt.Error, match="robot `anymal`: no `joints`"):
        gait.joints()
    with pytest.raises(cregopt.Error, match="rate: 0"):
        walk.joints(rate=0)
    with pytest.raises(cregopt.Error, match="robot `biped`: no `joints`"):
        walk.trajectory.joints(robot=cregopt.Robot("biped"))
