"""Robots, terrains and tasks."""

import json
import pathlib
from typing import Any, Callable

import cregopt
import numpy as np
import pytest


def test_robots_from_a_name_a_dictionary_and_a_file_are_equal(tmp_path: pathlib.Path) -> None:
    robot = cregopt.Robot("anymal")
    description = robot.to_dict()
    (tmp_path / "own.json").write_text(json.dumps(description))
    assert cregopt.Robot.from_dict(description) == robot == cregopt.Robot.from_file(tmp_path / "own.json")
    assert (robot.name, robot.mass, robot.feet) == ("anymal", 29.5, 4)
    feet = robot.nominal_feet
    assert feet.shape == (4, 3) and feet.dtype == np.float64 and feet.tolist() == description["nominal_feet"]
    # NumPy scalars and arrays are accepted.
    heavy = cregopt.Robot.from_dict({**description, "name": "own", "mass": np.float64(40.0), "nominal_feet": feet})
    assert heavy.mass == 40.0 and heavy != robot


def test_heights_are_at_the_positions_of_their_indices() -> None:
    z = np.arange(12.0).reshape(4, 3) / 100
    terrain = cregopt.Terrain.heights(z, cell=0.5, origin=(-1.0, 2.0), friction=0.6, name="ramp")
    assert (terrain.name, terrain.friction) == ("ramp", 0.6)
    for i in range(4):
        for j in range(3):
            assert terrain.height(-1.0 + 0.5 * i, 2.0 + 0.5 * j) == pytest.approx(z[i, j], abs=1e-12)
    # Other memory layouts and nested lists give the same map.
    for other in (np.asfortranarray(z), z[::-1][::-1], z.tolist()):
        assert cregopt.Terrain.heights(other, cell=0.5, origin=(-1.0, 2.0), friction=0.6, name="ramp") == terrain
    assert cregopt.Terrain.from_dict(terrain.to_dict()) == terrain
    holed = z.copy()
    holed[2, 1] = np.nan
    hole = cregopt.Terrain.heights(holed, cell=0.5).to_dict()["shape"]["grid"]["heights"]
    assert hole[2][1] == z.min() - 2.0 and hole[0] == z[0].tolist()
    assert cregopt.Terrain("flat", friction=0.5).friction == 0.5


def test_meshes_and_height_maps_are_imported(tmp_path: pathlib.Path) -> None:
    mesh = tmp_path / "ramp.obj"
    mesh.write_text("v -1 -1 0\nv 3 -1 0.4\nv 3 1 0.4\nv -1 1 0\nf 1 2 3 4\n")
    for terrain in (cregopt.Terrain.from_map(mesh, "hill", cell=0.5), cregopt.Terrain(str(mesh)), cregopt.Terrain.from_file(mesh)):
        assert terrain.height(0.7, 0.3) == pytest.approx(0.17, abs=1e-9)
    np.save(tmp_path / "map.npy", np.arange(6.0).reshape(2, 3) / 10)
    assert cregopt.Terrain.from_map(tmp_path / "map.npy", cell=0.5, origin=(1.0, 2.0)).height(1.5, 3.0) == pytest.approx(0.5)
    with pytest.raises(cregopt.Error, match="map.npy: --cell: missing"):
        cregopt.Terrain.from_map(tmp_path / "map.npy")
    with pytest.raises(cregopt.Error, match="from_map: cel: unknown field `cel`; did you mean `cell`"):
        cregopt.Terrain.from_map(mesh, cel=0.5)  # type: ignore[call-arg]


def test_a_task_has_the_given_start_and_goal() -> None:
    robot, terrain = cregopt.Robot("anymal"), cregopt.Terrain("flat")
    task = cregopt.Task(robot, terrain, goal=np.array([2.0, 0.3]), yaw=0.5, start=(1.0, 0.0), start_yaw=-0.1)
    assert (task.goal["xy"], task.goal["z"], task.goal["yaw"]) == ([2.0, 0.3], 0.5, 0.5)
    assert (task.start["xy"], task.start["yaw"]) == ([1.0, 0.0], -0.1)
    assert task.robot == robot and task.terrain == terrain and task.force_limit is None
    state = {"xy": [1.0, 0.0], "z": 0.45, "velocity": [0.2, 0.0, 0.0]}
    moving = cregopt.Task(robot, terrain, goal=state, start={"xy": [0.1, 0.0], "z": 0.48}, force_limit=300.0)
    assert moving.goal["velocity"] == [0.2, 0.0, 0.0] and moving.start["z"] == 0.48 and moving.force_limit == 300.0


def test_a_task_can_start_at_the_end_of_a_motion(gait: cregopt.Gait) -> None:
    end = gait.sample()
    for motion in (gait, gait.trajectory):
        task = cregopt.Task(gait.task.robot, gait.task.terrain, goal=(2.0, 0.1), start=motion)
        assert task.start["feet"] == pytest.approx(end.feet_position[-1, :, :2], abs=1e-9)
        assert task.start["yaw"] == pytest.approx(0.2, abs=1e-3)


ROBOT = cregopt.Robot("anymal")
FLAT = cregopt.Terrain("flat")


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: cregopt.Robot("anymall"), "unknown robot `anymall`; did you mean `anymal`"),
        (lambda: cregopt.Robot.from_dict({**ROBOT.to_dict(), "mass": -1}), "robot.mass: -1, but it must be"),
        (lambda: cregopt.Robot.from_dict({**ROBOT.to_dict(), "mass": 40.0}), "robot.name: `anymal`, but it must be a different name"),
        (lambda: cregopt.Robot.from_dict({**ROBOT.to_dict(), "mas": 1}), "robot: mas: unknown field `mas`; did you mean `mass`"),
        (lambda: cregopt.Robot.from_dict({"name": object()}), "robot: dict .*, but it must be finite numbers"),
        (lambda: cregopt.Robot.from_dict({**ROBOT.to_dict(), "mass": float("nan")}), "robot: dict .*, but it must be finite numbers"),
        (lambda: cregopt.Terrain("moon"), "unknown terrain `moon`"),
        (lambda: cregopt.Terrain("flat", friction=-1.0), "terrain.friction: -1, but it must be"),
        (lambda: cregopt.Terrain.heights(np.zeros((3, 3, 3)), 0.1), "height map: 3 dimensions, but it must be 2"),
        (lambda: cregopt.Terrain.heights(np.zeros((3, 0)), 0.1), "height map: 0 x 0 samples"),
        (lambda: cregopt.Terrain.heights(np.full((3, 3), np.nan), 0.1), "height map: only holes"),
        (lambda: cregopt.Terrain.heights(np.zeros((3, 3)), 0.1, name="stairs"), "terrain.name: `stairs`, but it must be a different name"),
        (lambda: cregopt.Terrain.heights(np.zeros((3, 3)), -0.1), "cell: -0.1, but it must be"),
        (lambda: cregopt.Task(ROBOT, FLAT, goal=(1.0,)), "goal: 1 numbers, but it must be 2 or 3"),
        (lambda: cregopt.Task(ROBOT, FLAT, goal="far"), "goal: 'far', but it must be 2 or 3 numbers"),  # type: ignore[arg-type]
        (lambda: cregopt.Task(ROBOT, FLAT, goal=(float("nan"), 0.0)), "goal.* must be"),
        (lambda: cregopt.Task(ROBOT, FLAT, goal={"xz": [0, 1]}), "goal: xz: unknown field `xz`; did you mean `xy`"),
        (lambda: cregopt.Task(ROBOT, FLAT, goal=(1.0, 0.0, -1.0)), r"goal.position\[2\]: -1, but it must be above the terrain"),
        (lambda: cregopt.Task(ROBOT, FLAT, goal=(1.0, 0.0), start={"feet": [[0.0, 0.0]]}), "start_feet: 1 feet"),
    ],
)
def test_errors_name_invalid_input(call: Callable[[], Any], sentence: str) -> None:
    with pytest.raises(cregopt.Error, match=sentence) as raised:
        call()
    assert isinstance(raised.value, ValueError)


def test_unreadable_files_raise_os_errors(tmp_path: pathlib.Path) -> None:
    for read in (cregopt.Robot.from_file, cregopt.Terrain.from_file, cregopt.Trajectory.from_file, cregopt.solve, cregopt.verify):
        with pytest.raises(FileNotFoundError, match="cannot read .*missing.json"):
            read(tmp_path / "missing.json")
    wrong = tmp_path / "wrong.json"
    wrong.write_text("{")
    with pytest.raises(cregopt.Error, match="wrong.json: .*EOF while parsing"):
        cregopt.Robot.from_file(wrong)


def test_a_task_can_be_read_from_a_scenario(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built_in = cregopt.Task.from_scenario("s3", target=4)
    assert cregopt.SCENARIOS[:3] == ("s1", "s2", "s3")
    assert (built_in.robot, built_in.terrain) == (ROBOT, cregopt.Terrain("step")) and built_in.goal["yaw"] == np.pi
    assert np.hypot(*built_in.goal["xy"]) == pytest.approx(6.0) and built_in.via == []
    angle = -np.pi / 4 + 3 / 19 * np.pi / 2
    assert np.arctan2(built_in.goal["xy"][1], built_in.goal["xy"][0]) == pytest.approx(angle)
    assert cregopt.Task.from_scenario("s1").goal == cregopt.Task.from_scenario("s1", 10).goal
    own = {**ROBOT.to_dict(), "name": "own", "mass": 31.0}
    (tmp_path / "own.json").write_text(json.dumps(own))
    path = tmp_path / "walk.toml"
    path.write_text(
        'robot = "own.json"\nterrain = "flat"\nforce_limit = 400.0\nseed = 3\n'
        "[start]\nxy = [1.0, 2.0]\nyaw = 0.3\nvelocity = [0.1, 0.0, 0.0]\n[goal]\nxy = [2.0, 2.5]\nyaw = 0.7\n"
        "[[waypoints]]\nxy = [1.5, 2.2]\nyaw = 0.4\n"
    )
    for task in (cregopt.Task.from_scenario(path), cregopt.Task.from_scenario(str(path))):
        assert task.robot == cregopt.Robot.from_dict(own) and task.terrain == FLAT and task.force_limit == 400.0
        assert (task.start["xy"], task.start["yaw"], task.start["velocity"]) == ([1.0, 2.0], 0.3, [0.1, 0.0, 0.0])
        assert (task.goal["xy"], task.goal["yaw"], task.goal["z"]) == ([2.0, 2.5], 0.7, 0.5)
        assert [(place["xy"], place["yaw"]) for place in task.via] == [([1.5, 2.2], 0.4)] and "by 1 waypoint" in repr(task)
    # A target replaces the file's goal and waypoints. A folder with the name of a scenario does not hide it.
    path.write_text('scenario = "s1"\n[goal]\nxy = [2.0, 2.5]\n[[waypoints]]\nxy = [1.5, 2.2]\n')
    to_target = cregopt.Task.from_scenario(path, target=4)
    assert to_target.goal == cregopt.Task.from_scenario("s1", 4).goal and to_target.via == []
    (tmp_path / "s1").mkdir()
    monkeypatch.chdir(tmp_path)
    assert cregopt.Task.from_scenario("s1", 4).goal == to_target.goal
    with pytest.raises(cregopt.Error, match="unknown scenario `s9`; did you mean `s1`"):
        cregopt.Task.from_scenario("s9")
    with pytest.raises(cregopt.Error, match="target: 21, but it must be 1 to 20"):
        cregopt.Task.from_scenario("s1", target=21)
    path.write_text("[goal]\nxy = [1.0, 0.0]\n")
    with pytest.raises(cregopt.Error, match="walk.toml: robot: none"):
        cregopt.Task.from_scenario(path)
    with pytest.raises(FileNotFoundError, match="missing.toml"):
        cregopt.Task.from_scenario(tmp_path / "missing.toml")


def test_a_base_arrives_at_waypoint_and_goal_in_time() -> None:
    via = {"xy": [0.3, 0.0], "z": 0.52, "yaw": 0.1, "time": 1.4}
    task = cregopt.Task(ROBOT, FLAT, {"xy": [0.6, 0.0], "time": 3.1}, via=[via])
    gait = cregopt.search(task, first=True, device="cpu")
    first, last = (stage.trajectory for stage in gait.stages)
    assert first.horizon == pytest.approx(1.4, abs=1e-9) and last.horizon == pytest.approx(1.7, abs=1e-9)
    end = first.sample()
    assert end.base_position[-1] == pytest.approx([0.3, 0.0, 0.52], abs=1e-3) and end.base_angles[-1, 2] == pytest.approx(0.1, abs=1e-3)
    with pytest.raises(cregopt.Error, match="goal: time: 1, but it must be later than 1.4 s"):
        cregopt.Task(ROBOT, FLAT, {"xy": [0.6, 0.0], "time": 1.0}, via=[via])


def test_errors_name_invalid_waypoints() -> None:
    task = cregopt.Task(ROBOT, FLAT, goal=(2.0, 0.0), via=[(0.5, 0.1), {"xy": [1.0, 0.0]}, {"xy": [1.5, 0.0], "yaw": 0.2}])
    assert [place.get("yaw") for place in task.via] == [None, None, 0.2] and task.via[0]["xy"] == [0.5, 0.1]
    assert len(cregopt.Task(ROBOT, FLAT, goal=(2.0, 0.0), via=np.array([[0.5, 0.1], [1.0, 0.0]])).via) == 2
    with pytest.raises(cregopt.Error, match=r"via\[1\]: 1 numbers, but it must be 2 or 3"):
        cregopt.Task(ROBOT, FLAT, goal=(2.0, 0.0), via=[(0.5, 0.1), (1.0,)])
    with pytest.raises(cregopt.Error, match=r"via\[0\].*position\[2\]: -1, but it must be above the terrain"):
        cregopt.Task(ROBOT, FLAT, goal=(2.0, 0.0), via=[(0.5, 0.1, -1.0)])
    with pytest.raises(cregopt.Error, match=r"task.via: 3 places, but it must be none"):
        cregopt.evaluate(task, [])


def test_a_yaw_that_may_be_in_degrees_causes_a_warning() -> None:
    with pytest.warns(UserWarning, match="goal yaw 45 rad is 7.2 turns; 45 degrees are 0.7854 rad"):
        cregopt.Task(ROBOT, FLAT, goal=(1.0, 0.0), yaw=45.0)
