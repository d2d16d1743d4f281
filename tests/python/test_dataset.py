"""Data sets as references of MuJoCo models, read by the loaders of mjlab and LocoMuJoCo where these are installed."""

import ast
import importlib.util
import json
import pathlib
import subprocess
import sys
import types
from typing import Any, Optional

import cregopt
import numpy as np
import pytest

mujoco: Any = pytest.importorskip("mujoco")
pytest.importorskip("daqp")

import cregopt.mujoco
from test_mujoco import main, model as model

RATE = 50
SPEC = f"""
count = 4
rate = {RATE}
length = 1.2
robots = ["small.toml"]
families = ["trot", "walk"]
kinds = ["rest", "steady"]
shard = 8
licence = "CC0-1.0"
[[commands]]
forward = [0.1, 0.3]
sideways = [-0.05, 0.05]
yaw = [-0.2, 0.2]
"""


@pytest.fixture(scope="module")
def data(model: pathlib.Path, program: str, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """Data set of that quadruped."""
    folder = tmp_path_factory.mktemp("data")
    cregopt.mujoco.robot(model).save(folder / "small.toml")
    (folder / "spec.toml").write_text(SPEC)
    made = subprocess.run([program, "dataset", "spec.toml", "--out", "data", "--device", "cpu"], cwd=folder, capture_output=True, text=True, timeout=120)
    if "unrecognized subcommand" in made.stderr:
        pytest.skip("the program was built without data sets")
    assert made.returncode == 0, made.stderr
    return folder / "data"


def first(data: pathlib.Path) -> dict[str, Any]:
    """First motion of the data set."""
    line: dict[str, Any] = json.loads((data / "small" / "gaits" / "00000.jsonl").read_text().splitlines()[0])
    return line


def test_a_reference_moves_as_its_plan_does(data: pathlib.Path, model: pathlib.Path) -> None:
    plan = cregopt.Trajectory.from_dict(first(data))
    fine = cregopt.mujoco.reference(plan, model, rate=1000)
    samples = plan.sample(rate=1000)
    assert fine.missed < 1e-4 and fine.beyond == 0
    # The centre of mass of the robot, which is the first body, is that of the plan.
    np.testing.assert_allclose(fine.subtree_com[:, 1], samples.base_position, atol=1e-5)
    # Velocities are the derivatives of positions, of joints and of bodies, except where accelerations of feet jump.
    joints, bodies = fine.qpos[:, 7:], fine.body_position
    for position, velocity in ((joints, fine.qvel[:, 6:]), (bodies, fine.body_velocity)):
        slope = (position[2:] - position[:-2]) * 500
        apart = np.abs(slope - velocity[1:-1])
        assert np.quantile(apart, 0.99) < 0.02 * np.abs(velocity).max() and apart.max() < 0.2 * np.abs(velocity).max()


def test_motions_that_begin_and_end_moving_are_followed(data: pathlib.Path, model: pathlib.Path, capsys: pytest.CaptureFixture[str]) -> None:
    plans = [json.loads(line) for line in (data / "small" / "gaits" / "00000.jsonl").read_text().splitlines()]
    speeds = [np.linalg.norm(cregopt.Trajectory.from_dict(plan).sample(rate=RATE).base_velocity[[0, -1]], axis=1) for plan in plans]
    assert any(start > 0.05 and end > 0.05 for start, end in speeds)
    reports = cregopt.mujoco.play_dataset(data, "small", model, seed=1)
    assert list(reports) == [f"small-00000-{number:05}" for number in range(len(plans))]
    assert all(report.followed and report.position_error_max < 0.03 for report in reports.values())
    code, _ = main(["dataset", str(data), "--robot", "small", "--model", str(model), "--play", "--most", "2", "--seed", "1"])
    assert code == 0 and capsys.readouterr().out.splitlines()[-1] == "2 of 2 motions followed"


@pytest.mark.parametrize("given", [["--play", "--format", "mjlab"], ["--out", "motions", "--seed", "1"], ["--out", "motions", "--json"]])
def test_options_of_the_other_action_are_refused(given: list[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["dataset", "data", "--robot", "small", "--model", "small.xml", *given])
    assert refused.value.code == 2


class StandIn:
    """NumPy in the place of PyTorch, for the few calls of the loader."""

    Tensor, float32, device = np.ndarray, np.float32, str

    @staticmethod
    def tensor(values: Any, dtype: Any, device: str) -> Any:
        return np.asarray(values, dtype)


def loader_of_mjlab() -> Optional[Any]:
    """mjlab's own class, with PyTorch or with NumPy in its place; None without mjlab."""
    spec = importlib.util.find_spec("mjlab")
    if spec is None or not spec.submodule_search_locations:
        return None
    path = pathlib.Path(spec.submodule_search_locations[0]) / "tasks" / "tracking" / "mdp" / "commands.py"
    tree = ast.parse(path.read_text())
    tree.body = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "MotionLoader"]
    torch = importlib.import_module("torch") if importlib.util.find_spec("torch") else StandIn
    names: dict[str, Any] = {"np": np, "torch": torch}
    exec(compile(tree, str(path), "exec"), names)
    return names["MotionLoader"]


def test_mjlab_loads_every_motion(data: pathlib.Path, model: pathlib.Path, tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _ = main(["dataset", str(data), "--robot", "small", "--model", str(model), "--out", str(tmp_path / "motions")])
    assert code == 0 and capsys.readouterr().out == "4 motions in 4 files, 0 that the model cannot follow\n"
    files = sorted((tmp_path / "motions").iterdir())
    machine = mujoco.MjModel.from_xml_path(str(model))
    frames, joints, bodies = round(1.2 * RATE) + 1, machine.njnt - 1, machine.nbody - 1
    shapes = {
        "fps": (1,),
        "joint_pos": (frames, joints),
        "joint_vel": (frames, joints),
        "body_pos_w": (frames, bodies, 3),
        "body_quat_w": (frames, bodies, 4),
        "body_lin_vel_w": (frames, bodies, 3),
        "body_ang_vel_w": (frames, bodies, 3),
    }
    loader, state = loader_of_mjlab(), mujoco.MjData(machine)
    for path in files:
        arrays = np.load(path)
        assert {key: arrays[key].shape for key in arrays} == shapes
        assert arrays["fps"][0] == RATE and all(np.isfinite(arrays[key]).all() for key in arrays)
        # Bodies are where the model has them for these joints.
        for frame in (0, frames // 2, frames - 1):
            state.qpos[:] = np.concatenate([arrays["body_pos_w"][frame, 0], arrays["body_quat_w"][frame, 0], arrays["joint_pos"][frame]])
            mujoco.mj_kinematics(machine, state)
            np.testing.assert_allclose(state.xpos[1:], arrays["body_pos_w"][frame], atol=1e-5)
        if loader is not None:
            torch = loader.__init__.__globals__["torch"]
            indexes = np.arange(bodies) if torch is StandIn else torch.arange(bodies)
            motion = loader(str(path), indexes)
            assert motion.time_step_total == frames and tuple(motion.body_quat_w.shape) == (frames, bodies, 4)


def trajectory_of_loco_mujoco() -> Optional[Any]:
    """LocoMuJoCo's own module of trajectories; None without it, or without JAX and Flax. The rest of the package is not imported."""
    found = [importlib.util.find_spec(name) for name in ("loco_mujoco", "jax", "flax")]
    if any(spec is None for spec in found) or found[0] is None or not found[0].submodule_search_locations:
        return None
    base = types.ModuleType("loco_mujoco.core.observations.base")
    setattr(base, "ObservationContainer", object)
    stubs = {name: types.ModuleType(name) for name in ("loco_mujoco", "loco_mujoco.core", "loco_mujoco.core.observations")}
    sys.modules.update({**stubs, base.__name__: base})
    path = pathlib.Path(found[0].submodule_search_locations[0]) / "trajectory" / "dataclasses.py"
    spec = importlib.util.spec_from_file_location("trajectories_of_loco_mujoco", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_loco_mujoco_loads_all_motions(data: pathlib.Path, model: pathlib.Path, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "motions.npz"
    done = cregopt.mujoco.export(data, "small", model, path, "loco-mujoco", most=3)
    assert (done.motions, done.files) == (3, [str(path)])
    machine, frames = mujoco.MjModel.from_xml_path(str(model)), 3 * (round(1.2 * RATE) + 1)
    arrays = np.load(path)
    shapes = {"qpos": machine.nq, "qvel": machine.nv, "xpos": (machine.nbody, 3), "xquat": (machine.nbody, 4), "cvel": (machine.nbody, 6), "subtree_com": (machine.nbody, 3)}
    shapes.update(site_xpos=(machine.nsite, 3), site_xmat=(machine.nsite, 9))
    for key, shape in shapes.items():
        assert arrays[key].shape == (frames, *np.atleast_1d(shape)), key
    assert arrays["split_points"].tolist() == [0, frames // 3, 2 * frames // 3, frames]
    module = trajectory_of_loco_mujoco()
    if module is None:
        return
    loaded = module.Trajectory.load(str(path), backend=np)
    assert loaded.info.frequency == RATE and loaded.info.joint_names[0] == "root" and loaded.info.model.njnt == machine.njnt
    assert loaded.data.qpos.shape == (frames, machine.nq) and loaded.data.is_complete
    assert loaded.data.get(1, 0, np).qpos.shape == (machine.nq,)


def test_bad_arguments_are_rejected(data: pathlib.Path, model: pathlib.Path, tmp_path: pathlib.Path) -> None:
    for arguments, text in (
        ((data, "big", model, tmp_path), "robot 'big': must be one of small"),
        ((tmp_path, "small", model, tmp_path), "dataset.json"),
        ((data, "small", tmp_path / "none.xml", tmp_path), "there is no such model file"),
    ):
        with pytest.raises((cregopt.Error, OSError), match=text):
            cregopt.mujoco.export(*arguments)
    with pytest.raises(cregopt.Error, match="form 'csv': must be one of mjlab, loco-mujoco"):
        cregopt.mujoco.export(data, "small", model, tmp_path, "csv")
