"""Copies by ``pickle`` and ``copy``."""

import copy
import pickle

import cregopt
import numpy as np
import pytest


def again(task: cregopt.Task) -> cregopt.Task:
    """Pickled copy of a task, after a check that it equals the task."""
    copied: cregopt.Task = pickle.loads(pickle.dumps(task))
    for name in ("robot", "terrain", "start", "goal", "via", "force_limit", "scenario"):
        assert getattr(copied, name) == getattr(task, name), name
    assert repr(copied) == repr(task)
    return copied


def test_a_copied_task_equals_the_original(task: cregopt.Task, gait: cregopt.Gait) -> None:
    again(task)
    z = np.random.default_rng(3).uniform(0.0, 0.05, (40, 30))
    terrain = cregopt.Terrain.heights(z, cell=0.15, origin=(-2.0, -2.0), friction=0.6, name="rough")
    goal = {"xy": [1.0, 0.1], "z": 0.52, "yaw": 3.0, "tilt": [0.01, -0.02], "velocity": [0.1, 0.0, 0.0], "rates": [0.0, 0.1, 0.0]}
    rough = cregopt.Task(task.robot, terrain, goal, start=(0.1, 0.05), start_yaw=1 / 3, force_limit=300.0)
    assert again(rough).terrain.height(0.33, 0.21) == terrain.height(0.33, 0.21)
    route = cregopt.Task(task.robot, task.terrain, goal=(2.0, 0.0), yaw=0.4, start=gait, via=[(1.4, 0.1), {"xy": [1.7, 0.0], "yaw": 0.1}])
    assert ["yaw" in place for place in again(route).via] == [False, True]
    timed = cregopt.Task(task.robot, task.terrain, {"xy": [2.0, 0.0], "time": 5.0}, via=[{"xy": [1.0, 0.0], "time": 2.5}])
    assert again(timed).goal["time"] == 5.0 and timed.via[0]["time"] == 2.5


def test_a_copied_task_has_the_same_gaits_and_scenario(gait: cregopt.Gait) -> None:
    task = cregopt.Task.from_scenario("s1", target=3)
    assert task.scenario == ("s1", 3)
    found = [cregopt.search(t, gaits="trot", first=True, device="cpu").trajectory for t in (task, again(task))]
    assert found[0] == found[1] and found[0].to_dict()["scenario"] == "s1"
    assert pickle.loads(pickle.dumps(found[0])) == found[0]
    with pytest.raises(cregopt.Error, match="unknown scenario `s9`"):
        task._named("s9", None)


def test_a_built_in_robot_with_a_larger_reach_can_be_copied(task: cregopt.Task) -> None:
    # The diagnosis of a search without a gait uses such robots.
    description = task.robot.to_dict()
    farther = cregopt.Robot._again({**description, "reach": [1.25 * half for half in description["reach"]]})
    with pytest.raises(cregopt.Error, match="another reach"):
        cregopt.Robot.from_dict(farther.to_dict())
    again(cregopt.Task(farther, task.terrain, task.goal))
    assert pickle.loads(pickle.dumps(farther)) == farther


def test_a_copied_motion_has_the_same_force_limit(task: cregopt.Task, gait: cregopt.Gait) -> None:
    strong = cregopt.Task(task.robot, task.terrain, task.goal, force_limit=1000.0)
    found = cregopt.evaluate(strong, [gait.schedule], trajectories=True, device="cpu")
    assert found.trajectories is not None
    motion = found.trajectories[0]
    for copied in (pickle.loads(pickle.dumps(motion)), copy.deepcopy(motion)):
        assert copied == motion and str(cregopt.verify(copied)) == str(cregopt.verify(motion))


def test_a_copied_evaluation_equals_the_original(task: cregopt.Task, gait: cregopt.Gait) -> None:
    short = [[0.1] for _ in gait.schedule]
    found = cregopt.evaluate(task, [gait.schedule, short], trajectories=True, device="cpu")
    for copied in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        for name in ("feasible", "n_violated", "max_violation", "cost", "iterations", "horizon"):
            np.testing.assert_array_equal(getattr(copied, name), getattr(found, name))
        assert copied.trajectories == found.trajectories and len(copied) == 2 and np.isnan(copied.cost[1])


def test_columns_of_an_evaluation_must_have_equal_lengths(task: cregopt.Task, gait: cregopt.Gait) -> None:
    found = cregopt.evaluate(task, [gait.schedule], device="cpu")
    columns = (found.feasible, found.n_violated, found.max_violation, found.cost, found.iterations)
    with pytest.raises(cregopt.Error, match="horizon: 3 values, but it must be 1, as many as in `feasible`"):
        cregopt.Evaluation(*columns, np.ones(3))
    with pytest.raises(cregopt.Error, match="trajectories: 0 values"):
        cregopt.Evaluation(*columns, found.horizon, [])
