"""Examples and notebooks of `benches/examples`, as they are written. The one for MuJoCo is in `test_mujoco.py`."""

import json
import pathlib
from typing import Callable

import pytest

FOLDER = pathlib.Path(__file__).parents[2] / "benches" / "examples"
EXAMPLES = [path.stem for path in sorted(FOLDER.glob("*.py"))]
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@pytest.mark.parametrize("name", [name for name in EXAMPLES if "mujoco" not in name])
def test_an_example_runs(run_example: Callable[..., str], name: str) -> None:
    assert run_example(name)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
def test_a_notebook_runs(monkeypatch: pytest.MonkeyPatch, path: pathlib.Path) -> None:
    # No windows.
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, object] = {}
    cells = [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]
    for cell in cells:
        exec("".join(cell["source"]), names)
    assert len(cells) > 3
