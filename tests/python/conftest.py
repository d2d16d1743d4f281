"""Fixtures of the tests."""

import ctypes.util
import os
import pathlib
import subprocess
import sys
from typing import Callable

import cregopt
import pytest

# Without a display pictures are rendered off-screen. MuJoCo reads this variable when it is imported.
if sys.platform == "linux" and not os.environ.get("DISPLAY") and ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")


@pytest.fixture(scope="session")
def task() -> cregopt.Task:
    """Task with a short displacement and a turn."""
    return cregopt.Task(cregopt.Robot("anymal"), cregopt.Terrain("flat"), goal=(1.0, 0.1), yaw=0.2)


@pytest.fixture(scope="session")
def gait(task: cregopt.Task) -> cregopt.Gait:
    """Feasible trot of the task."""
    return cregopt.search(task, gaits="trot", population=4, generations=1, device="cpu")


@pytest.fixture(scope="session")
def drawn(task: cregopt.Task) -> cregopt.Gait:
    """Feasible gait with durations as drawn and the first motion that holds, as an evaluation finds it."""
    plain = {"search": {"optimise_iterations": 0, "duration_steps": 0}}
    return cregopt.search(task, population=4, generations=1, device="cpu", settings=plain)


@pytest.fixture(scope="session")
def nowhere() -> cregopt.Task:
    """Task without a feasible gait: three feet cannot carry the weight, and the goal can only be reached by steps."""
    robot = cregopt.Robot("anymal")
    return cregopt.Task(robot, cregopt.Terrain("flat"), goal=(1.0, 0.0), force_limit=0.27 * 9.80665 * robot.mass)


@pytest.fixture(scope="session")
def run_example() -> Callable[..., str]:
    """Runs an example of `benches/examples` and returns its output. Examples assert their own results, so that a wrong one ends them."""

    def run(name: str, *arguments: str) -> str:
        example = pathlib.Path(__file__).parents[2] / "benches" / "examples" / f"{name}.py"
        ran = subprocess.run([sys.executable, str(example), *arguments], capture_output=True, text=True, timeout=120)
        assert ran.returncode == 0, ran.stdout + ran.stderr
        return ran.stdout

    return run


@pytest.fixture(scope="session")
def program() -> str:
    """Path of the most recently built command-line program."""
    root = pathlib.Path(__file__).parents[2]
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", root / "target"))
    named = os.environ.get("CREGOPT_PROGRAM")
    paths = [pathlib.Path(named)] if named else [target / profile / "cregopt" for profile in ("quick", "release", "debug")]
    built = [path for path in paths if path.is_file()]
    if not built:
        pytest.skip("the program is not built; CREGOPT_PROGRAM names it")
    return str(max(built, key=lambda path: path.stat().st_mtime))
