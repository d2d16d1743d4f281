"""Motions, samples, certificates and batches."""

import pathlib

import cregopt
import numpy as np
import pytest

GRAVITY = 9.80665


def test_samples_have_documented_shapes_and_are_consistent(gait: cregopt.Gait) -> None:
    s, robot = gait.sample(rate=1000), gait.task.robot
    n = len(s)
    assert n == round(gait.trajectory.horizon * 1000) + 1 and s.time[0] == 0 and s.time[-1] == gait.trajectory.horizon
    shapes = {
        "time": (n,),
        "base_position": (n, 3),
        "base_quaternion": (n, 4),
        "base_angles": (n, 3),
        "base_velocity": (n, 3),
        "base_angular_velocity": (n, 3),
        "feet_position": (n, 4, 3),
        "feet_velocity": (n, 4, 3),
        "forces": (n, 4, 3),
    }
    for name, shape in shapes.items():
        array = getattr(s, name)
        assert array.shape == shape and array.dtype == np.float64 and np.isfinite(array).all(), name
    assert s.contacts.shape == (n, 4) and s.contacts.dtype == np.bool_ and s.feet_names == ["LF", "RF", "LH", "RH"]
    # Order w, x, y, z: the final attitude is a rotation by 0.2 rad about z.
    assert s.base_quaternion[-1] == pytest.approx([np.cos(0.1), 0, 0, np.sin(0.1)], abs=1e-3)
    assert np.linalg.norm(s.base_quaternion, axis=1) == pytest.approx(1.0)
    assert s.base_position[-1] == pytest.approx([1.0, 0.1, 0.5], abs=1e-3)
    # Velocities are derivatives of positions. Stance feet do not move; swing feet carry no load.
    slopes = np.gradient(s.base_position, s.time, axis=0)
    assert slopes[1:-1] == pytest.approx(s.base_velocity[1:-1], abs=1e-2)
    assert np.abs(s.forces[~s.contacts]).max() == 0.0
    assert np.abs(s.feet_velocity[s.contacts]).max() < 1e-9 and s.feet_position[:, :, 2].max() > 0.03
    # The mean ground reaction force equals the weight.
    step = np.diff(s.time)[:, None]
    total = s.forces.sum(axis=1)
    mean = ((total[1:] + total[:-1]) / 2 * step).sum(axis=0) / s.time[-1]
    assert mean == pytest.approx([0.0, 0.0, robot.mass * GRAVITY], abs=1.0)
    assert len(gait.sample()) == len(gait.sample(rate=100.0)) == len(gait.trajectory.sample()) < n
    with pytest.raises(cregopt.Error, match="rate, Hz: -1, but it must be"):
        gait.sample(rate=-1)


def test_samples_are_writable_and_independent(gait: cregopt.Gait) -> None:
    one, other = gait.sample(), gait.sample()
    one.forces[:] = 1.0
    assert not (other.forces == 1.0).all()


def test_a_trajectory_survives_files_and_dictionaries(gait: cregopt.Gait, tmp_path: pathlib.Path) -> None:
    trajectory = gait.trajectory
    trajectory.save(tmp_path / "trajectory.json")
    again = cregopt.Trajectory.from_file(tmp_path / "trajectory.json")
    assert again == trajectory == cregopt.Trajectory.from_dict(trajectory.to_dict())
    assert again.to_json() == trajectory.to_json() and again.schedule == gait.schedule
    with pytest.raises(cregopt.Error, match="trajectory: missing field"):
        cregopt.Trajectory.from_dict({})


def test_a_motion_is_verified_independently_of_its_search(gait: cregopt.Gait, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "trajectory.json"
    gait.trajectory.save(path)
    for motion in (gait, gait.trajectory, gait.trajectory.to_dict(), path, str(path)):
        certificate = cregopt.verify(motion)
        assert certificate.feasible and certificate.to_dict() == gait.certificate.to_dict()
    assert "robot anymal, built in; terrain flat, built in" in str(certificate) and len(certificate.terms) > 3
    heavy = cregopt.Robot.from_dict({**gait.task.robot.to_dict(), "name": "heavy", "mass": 40.0})
    assert not cregopt.verify(gait, robot=heavy).feasible
    icy = cregopt.verify(path, terrain=cregopt.Terrain("flat", friction=0.01))
    assert not icy.feasible and icy.n_violated > 0 and icy.max_violation > 0
    assert not cregopt.verify(gait, force_limit=10.0).feasible
    with pytest.raises(cregopt.Error, match="force_limit: -1"):
        cregopt.verify(gait, force_limit=-1.0)
    with pytest.raises(TypeError):
        cregopt.verify(3)  # type: ignore[arg-type]


def test_a_manipulated_motion_is_not_certified(gait: cregopt.Gait) -> None:
    description = gait.trajectory.to_dict()
    description["ee"][0]["force"]["nodes"][1][2] += 20.0
    assert not cregopt.verify(cregopt.Trajectory.from_dict(description)).feasible


def test_a_gait_on_a_height_map_is_found_and_certified() -> None:
    x = np.arange(60) * 0.05 - 0.75
    z = np.repeat(np.where(x > 0.6, 0.05, 0.0)[:, None], 40, axis=1)
    terrain = cregopt.Terrain.heights(z, cell=0.05, origin=(-0.75, -1.0))
    gait = cregopt.search(cregopt.Task(cregopt.Robot("anymal"), terrain, goal=(1.2, 0.0)), first=True)
    assert gait.feasible and cregopt.verify(gait.trajectory.to_dict()).feasible
    assert gait.sample().feet_position[-1, :2, 2] == pytest.approx(0.05, abs=1e-3)


def test_an_evaluation_has_one_row_per_schedule(task: cregopt.Task, drawn: cregopt.Gait) -> None:
    standing = [[0.5]] * 4
    found = cregopt.evaluate(task, [drawn.schedule, standing, np.array(standing)], trajectories=True, device="cpu")  # type: ignore[list-item]
    assert len(found) == 3 and found.feasible.tolist() == [True, False, False]
    for name, dtype in {
        "feasible": np.bool_,
        "n_violated": np.int64,
        "iterations": np.int64,
        "max_violation": np.float64,
        "cost": np.float64,
        "horizon": np.float64,
    }.items():
        assert getattr(found, name).shape == (3,) and getattr(found, name).dtype == dtype
    assert found.n_violated[0] == 0 < found.n_violated[1] == found.n_violated[2]
    assert drawn.cost is not None and found.cost[0] == drawn.cost["total"] and np.isnan(found.cost[1])
    assert found.horizon == pytest.approx([drawn.trajectory.horizon, 0.5, 0.5])
    assert found.trajectories is not None
    assert [cregopt.verify(t).feasible for t in found.trajectories] == [True, False, False]
    assert found.trajectories[0].schedule == drawn.schedule
    assert cregopt.evaluate(task, [standing]).trajectories is None
    none = cregopt.evaluate(task, [], settings={"solver": {"max_iterations": 3}})
    assert len(none) == 0 and none.feasible.shape == (0,)
    few = cregopt.evaluate(task, [drawn.schedule], settings={"solver": {"max_iterations": 1}})
    assert few.iterations[0] < found.iterations[0]


def test_errors_name_invalid_schedules(task: cregopt.Task) -> None:
    with pytest.raises(cregopt.Error, match=r"schedules\[1\]: durations: 3 feet, but it must be 4"):
        cregopt.evaluate(task, [[[0.5]] * 4, [[0.5]] * 3])
    with pytest.raises(cregopt.Error, match=r"schedules\[0\]: .*-0.5"):
        cregopt.evaluate(task, [[[-0.5]] * 4])
    with pytest.raises(TypeError):
        cregopt.evaluate(task, [["long"] * 4])  # type: ignore[list-item]
