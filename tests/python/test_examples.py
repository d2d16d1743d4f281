"""Examples of `benches/examples`, as they are written. The one for MuJoCo is in `test_mujoco.py`."""

import pathlib
from typing import Callable

import pytest

EXAMPLES = [path.stem for path in sorted((pathlib.Path(__file__).parents[2] / "benches" / "examples").glob("*.py"))]


@pytest.mark.parametrize("name", [name for name in EXAMPLES if "mujoco" not in name])
def test_an_example_runs(run_example: Callable[..., str], name: str) -> None:
    assert run_example(name)
