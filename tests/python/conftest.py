"""What the tests share."""

import os
import pathlib

import cregopt
import pytest


@pytest.fixture(scope="session")
def task() -> cregopt.Task:
    """A short way that turns."""
    return cregopt.Task(cregopt.Robot("anymal"), cregopt.Terrain("flat"), goal=(1.0, 0.1), yaw=0.2)


@pytest.fixture(scope="session")
def gait(task: cregopt.Task) -> cregopt.Gait:
    return cregopt.search(task, population=4, generations=1, device="cpu")


@pytest.fixture(scope="session")
def nowhere() -> cregopt.Task:
    """A task with no gait: feet that bear less than the robot's weight together as soon as one is lifted, and a goal that it must step to."""
    robot = cregopt.Robot("anymal")
    return cregopt.Task(robot, cregopt.Terrain("flat"), goal=(1.0, 0.0), force_limit=0.27 * 9.80665 * robot.mass)


@pytest.fixture(scope="session")
def program() -> str:
    """The program as it was built last."""
    root = pathlib.Path(__file__).parents[2]
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", root / "target"))
    named = os.environ.get("CREGOPT_PROGRAM")
    paths = [pathlib.Path(named)] if named else [target / profile / "cregopt" for profile in ("quick", "release", "debug")]
    built = [path for path in paths if path.is_file()]
    if not built:
        pytest.skip("the program is not built; CREGOPT_PROGRAM names it")
    return str(max(built, key=lambda path: path.stat().st_mtime))
