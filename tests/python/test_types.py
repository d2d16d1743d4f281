"""Types of the package and of a sample under mypy, and the stubs against the compiled module."""

import pathlib
import subprocess
import sys

import cregopt
import pytest

SAMPLE = """
import cregopt
import numpy as np
from cregopt import distributed

terrain = cregopt.Terrain.heights(np.zeros((20, 20)), cell=0.2, origin=(-2.0, -2.0))
task = cregopt.Task(cregopt.Robot("anymal"), terrain, goal=(1.0, 0.0), yaw=0.1)
gait = cregopt.search(task, first=True, gaits=["trot"], settings={"solver": {"max_iterations": 50}}, progress=print)
total: float = gait.cost["total"] if gait.cost else float("nan")
force: float = float(gait.sample(rate=50).forces.max())
found = cregopt.evaluate(task, [gait.schedule], trajectories=True)
first: bool = bool(found.feasible[0])
again = cregopt.Task(task.robot, terrain, (2.0, 0.0), start=gait)
robot = cregopt.Robot.from_urdf("go2.urdf", feet=["FL", "FR"], configuration={"knee": -1.5})
scenario = cregopt.Task.from_scenario("walk.toml")
route = cregopt.Task(robot, terrain, (2.0, 0.0), start={"xy": [0.5, 0.0]}, start_yaw=0.1, via=[(1.0, 0.0), {"xy": [1.5, 0.0], "yaw": 0.2}])
torque: float = float(cregopt.search(route).stages[0].joints(rate=50).efforts.max())
wide = distributed.search(task, population=256, cpus=4, gpus=0.5, progress=True).alternatives
for stage in cregopt.solve("walk.toml", progress=True):
    print(str(cregopt.verify(stage)), stage.certificate["n_rows"])
feet = task.robot.nominal_feet + [0.0, 0.0, 0.5]
state = cregopt.RobotState([0.0, 0.0, 0.5], np.eye(3), np.zeros(3), np.zeros(3), feet, 0 * feet, [True] * 4)
update = cregopt.Planner(task.robot, terrain, {"families": ["trot"]}).update(state, (0.5, 0.0, 0.0), now=0.0)
heights: float = float(update.plan.sample(rate=500).feet_position[..., 2].max()) + update.seconds
"""


def mypy(*arguments: str, cwd: pathlib.Path) -> str:
    """Messages of ``mypy --strict``; empty if it finds no error."""
    pytest.importorskip("mypy")
    run = subprocess.run([sys.executable, "-m", "mypy", "--strict", *arguments], cwd=cwd, capture_output=True, text=True, timeout=300)
    return "" if run.returncode == 0 else run.stdout + run.stderr


def test_the_package_and_a_sample_pass_mypy(tmp_path: pathlib.Path) -> None:
    (tmp_path / "sample.py").write_text(SAMPLE)
    assert mypy("-p", "cregopt", cwd=tmp_path) == ""
    assert mypy("sample.py", cwd=tmp_path) == ""


def test_mypy_finds_wrong_uses(tmp_path: pathlib.Path) -> None:
    (tmp_path / "wrong.py").write_text(SAMPLE + "\ngait.forces\ncregopt.search(task, popultion=3)\n")
    messages = mypy("wrong.py", cwd=tmp_path)
    assert '"Gait" has no attribute "forces"' in messages and 'Unexpected keyword argument "popultion"' in messages


def test_stubs_match_the_compiled_module(tmp_path: pathlib.Path) -> None:
    pytest.importorskip("mypy")
    check = [sys.executable, "-m", "mypy.stubtest", "cregopt._cregopt", "--ignore-missing-stub", "--ignore-disjoint-bases"]
    run = subprocess.run(check, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stdout + run.stderr


def test_all_public_items_have_docstrings() -> None:
    for name in cregopt.__all__:
        thing = getattr(cregopt, name)
        if not isinstance(thing, (str, tuple)):
            assert thing.__doc__, name
