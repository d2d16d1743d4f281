"""Searches, gaits and their files."""

import base64
import json
import pathlib
import re
import subprocess
import sys
import warnings
from typing import Any

import cregopt
import pytest


def test_a_gait_agrees_with_its_certificate(gait: cregopt.Gait) -> None:
    assert gait.feasible and gait.family == "trot" and gait.diagnosis is None
    assert gait.cost is not None and 0 < gait.cost["leg_work"] < gait.cost["total"] < 10
    assert len(gait.schedule) == 4 and all(sum(foot) == pytest.approx(gait.trajectory.horizon) for foot in gait.schedule)
    certificate = gait.certificate
    assert certificate.feasible and certificate.n_violated == 0 and certificate["n_rows"] > 1000
    assert dict(certificate) == certificate.to_dict()
    assert str(certificate).startswith("feasible: 0 of ")
    assert "gait found in" in str(gait) and "trot" in repr(gait)
    with pytest.raises(KeyError):
        certificate["nothing"]


def test_options_reach_the_search(task: cregopt.Task) -> None:
    records: list[dict[str, Any]] = []
    gait = cregopt.search(
        task,
        seed=7,
        gaits=["pace", "trot"],
        population=3,
        generations=1,
        alternatives=2,
        objective="effort",
        threads=1,
        device="cpu",
        settings={"search": {"perturbed_generations": 0}, "solver": {"max_iterations": 40}, "transcription": {"foot_acceleration": None}},
        progress=records.append,
    )
    result = gait.to_dict()
    assert result["seed"] == 7 and result["device"].startswith("cpu, 1 threads")
    assert result["lower"]["solver"]["max_iterations"] == 40 and result["lower"]["transcription"]["foot_acceleration"] is None
    assert result["search"]["gaits"] == {"families": ["pace", "trot"]} and result["search"]["objective"] == "effort"
    assert [g["generation"] for g in records if g["event"] == "generation"] == [0, 1]
    assert [g["family"] for g in records if g["event"] == "improvement"] == [i["family"] for i in result["improvements"]]
    assert {gait.family, *(g.family for g in gait.alternatives)} == {"pace", "trot"}
    assert gait.alternatives[0].feasible and gait.alternatives[0].schedule == result["alternatives"][0]["durations"]
    first = cregopt.search(task, first=True)
    assert first.feasible and first.to_dict()["generations"][-1]["generation"] == 0
    assert first.to_dict()["search"]["gaits"] == "all"
    papers = cregopt.search(task, preset="experiment1", first=True, population=4, generations=1)
    assert papers.to_dict()["search"]["gaits"] == "free"
    around = cregopt.search(task, gaits=gait.schedule, first=True, seconds=60.0)
    assert around.schedule == gait.schedule
    few = {"refine": {"iterations": 3}}
    refined = cregopt.search(task, first=True, refine=True, precision="f64", smooth=True, transcription="momentum", settings=few)
    assert refined.to_dict()["refinement"]["iterations"] == 3
    assert refined.to_dict()["refinement"]["before"]["total"] > refined.cost["total"]  # type: ignore[index]


def test_progress_is_shown_as_a_bar(task: cregopt.Task, tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("tqdm")
    gait = cregopt.search(task, gaits="trot", population=3, generations=1, device="cpu", progress=True)
    line = capsys.readouterr().err.splitlines()[-1]
    generations = gait.to_dict()["generations"]
    evaluated, feasible = (sum(generation[key] for generation in generations) for key in ("evaluated", "feasible"))
    assert gait.cost is not None
    assert re.search(rf"best trot, {gait.cost['total']:.3f} after [0-9.]* s: {evaluated} candidates .*{feasible} gaits\]", line), line
    (tmp_path / "walk.toml").write_text('robot = "anymal"\nfirst = true\ngoal = { xy = [1.0, 0.0] }\n')
    cregopt.solve(tmp_path / "walk.toml", progress=True)
    assert " after " in capsys.readouterr().err
    cregopt.search(task, first=True, progress=False)
    assert capsys.readouterr().err == ""


def test_a_search_on_lower_ground_reports_its_levels(capsys: pytest.CaptureFixture[str]) -> None:
    high = cregopt.Task(cregopt.Robot("hyq"), cregopt.Terrain("block"), goal=(2.0, 0.0))
    records: list[dict[str, Any]] = []
    options: dict[str, Any] = {"first": True, "generations": 0, "device": "cpu"}
    options["settings"] = {"search": {"further_generations": 0, "relief_levels": 2}}
    gait = cregopt.search(high, progress=records.append, **options)
    levels = [record for record in records if record["event"] == "lower-ground"]
    assert not gait.feasible and [record["levels"] for record in levels] == [1, 2]
    reached = gait.to_dict()["lower_ground"]
    assert reached == {key: levels[-1][key] for key in reached} and 0.1 < reached["share"] < 1
    assert f"{100 * reached['share']:.1f} % of the height differences" in str(gait.diagnosis)
    pytest.importorskip("tqdm")
    capsys.readouterr()
    cregopt.search(high, progress=True, **options)
    assert f"a gait on {100 * reached['share']:.0f} % of the relief" in capsys.readouterr().err


def test_without_tqdm_the_error_names_the_package_to_install(task: cregopt.Task, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    with pytest.raises(ImportError, match=r"pip install cregopt\[progress\]"):
        cregopt.search(task, progress=True)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"seed": -1}, "seed: invalid value: integer `-1`"),
        ({"population": "many"}, "population: invalid type: string"),
        ({"population": 0}, "search.population: 0, but it must be an integer from 1"),
        ({"device": "tpu"}, "device: `tpu`"),
        ({"device": "gpu", "precision": "f64"}, "which only the CPU has"),
        ({"threads": 99999}, "threads: 99999, but it must be at most"),
        ({"gaits": "trott"}, "unknown gait `trott`; did you mean `trot`"),
        ({"gaits": [[0.5], [0.5]]}, "2 feet, but it must be 4 feet"),
        ({"objective": "beauty"}, "unknown objective `beauty`"),
        ({"preset": "other"}, "unknown preset `other`"),
        ({"seconds": -1.0}, "search.seconds: -1"),
        ({"settings": {"serch": {}}}, "unknown table of settings `serch`"),
        ({"settings": {"search": 3}}, "settings.search: 3, but it must be a table"),
        ({"settings": {"search": {"populaton": 3}}}, "settings.search: unknown setting `populaton`; did you mean `population`"),
        ({"settings": {"solver": {"max_iterations": "many"}}}, "settings.solver.max_iterations: invalid type: string"),
        ({"settings": {"solver": {"tolerance": -1.0}}}, "solver.tolerance: -1, but it must be"),
        ({"settings": {"solver": {"nothing": None}}}, "unknown setting `solver.nothing`"),
        ({"settings": {"solver": {"tolerance": float("inf")}}}, "options: dict .*, but it must be finite numbers"),
    ],
)
def test_errors_name_invalid_options(task: cregopt.Task, options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(cregopt.Error, match=sentence):
        cregopt.search(task, **options)


def test_a_search_without_a_feasible_gait_has_a_diagnosis(nowhere: cregopt.Task) -> None:
    settings = {"search": {"further_generations": 0, "perturbed_generations": 0}}
    gait = cregopt.search(nowhere, gaits="trot", population=2, generations=0, settings=settings)
    assert not gait.feasible and gait.cost is None and not gait.certificate.feasible
    assert gait.diagnosis is not None and gait.diagnosis["broken"] and "no feasible gait" in str(gait)
    assert "not feasible" in repr(gait) and gait.certificate.n_violated == gait.to_dict()["n_violated"] > 0


def test_an_impossible_task_is_rejected_before_the_search(task: cregopt.Task) -> None:
    far = cregopt.Task(task.robot, task.terrain, goal=(1.0, 0.0, 0.9))
    with pytest.raises(cregopt.Error, match="goal"):
        cregopt.search(far)


def test_doubts_are_warnings_that_can_be_turned_into_errors(task: cregopt.Task) -> None:
    weak = cregopt.Task(task.robot, task.terrain, goal=(1.0, 0.0), force_limit=50.0)
    options: dict[str, Any] = {"gaits": "trot", "population": 2, "generations": 0, "settings": {"search": {"further_generations": 0}}}
    with pytest.warns(UserWarning, match="force limit: 4 feet with at most 50.0 N each") as warned:
        gait = cregopt.search(weak, **options)
    assert not gait.feasible and [f["place"] for f in gait.to_dict()["warnings"]] == ["force limit"] and len(warned) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UserWarning, match="force limit"):
            cregopt.search(weak, **options)


def without_times(result: Any) -> Any:
    """Result without measured times."""
    if isinstance(result, dict):
        clocks = ("seconds", "first_feasible_seconds")
        return {key: without_times(value) for key, value in result.items() if key not in clocks}
    return [without_times(value) for value in result] if isinstance(result, list) else result


def test_the_program_finds_the_same_gait_bit_for_bit(gait: cregopt.Gait, program: str, tmp_path: pathlib.Path) -> None:
    command = "solve --robot anymal --goal 1,0.1 --yaw 0.2 --gait trot --population 4 --generations 1 --device cpu --seed 1 --out out"
    subprocess.run([program, *command.split()], cwd=tmp_path, check=True, capture_output=True, timeout=300)
    assert (tmp_path / "out/trajectory.json").read_text() == gait.trajectory.to_json() + "\n"
    gait.save(tmp_path / "own")
    assert sorted(path.name for path in (tmp_path / "own").iterdir()) == sorted(path.name for path in (tmp_path / "out").iterdir())
    for name in ("trajectory.json", "scenario.toml"):
        assert (tmp_path / "own" / name).read_text() == (tmp_path / "out" / name).read_text()
    results = [json.loads((tmp_path / folder / "result.json").read_text()) for folder in ("own", "out")]
    assert without_times(results[0]) == without_times(results[1])
    assert results[0] == json.loads(gait.to_json()) == gait.to_dict()


def test_a_saved_scenario_file_reproduces_its_gait(gait: cregopt.Gait, tmp_path: pathlib.Path) -> None:
    gait.save(tmp_path)
    again = cregopt.solve(tmp_path / "scenario.toml", out=tmp_path / "again")
    assert [g.trajectory.to_json() for g in again] == [gait.trajectory.to_json()]
    assert (tmp_path / "again/trajectory.json").read_text() == (tmp_path / "trajectory.json").read_text()


def test_a_scenario_with_waypoints_has_a_gait_per_stage(tmp_path: pathlib.Path) -> None:
    (tmp_path / "walk.toml").write_text(
        'robot = "anymal"\nfirst = true\ngoal = { xy = [1.0, 0.0] }\n[[waypoints]]\nxy = [0.5, 0.1]\n'
    )
    stages = cregopt.solve(str(tmp_path / "walk.toml"))
    assert len(stages) == 2 and all(stage.feasible for stage in stages)
    assert stages[1].task.start["xy"] == pytest.approx([0.5, 0.1], abs=1e-3)
    (tmp_path / "bad.toml").write_text('robt = "anymal"\n')
    with pytest.raises(cregopt.Error, match="bad.toml: .*unknown field `robt`"):
        cregopt.solve(tmp_path / "bad.toml")


def test_a_task_with_waypoints_has_a_gait_per_stage(task: cregopt.Task, program: str, tmp_path: pathlib.Path) -> None:
    route = cregopt.Task(task.robot, task.terrain, goal=(1.0, 0.0), yaw=0.4, start=(0.1, 0.0), start_yaw=0.1, via=[(0.4, 0.1), (0.7, 0.0)])
    gait = cregopt.search(route, first=True, device="cpu")
    stages = gait.stages
    assert len(stages) == 3 and all(stage.feasible for stage in stages) and [len(stage.stages) for stage in stages] == [1, 2, 3]
    assert [stage.task.goal["xy"] for stage in stages] == [[0.4, 0.1], [0.7, 0.0], [1.0, 0.0]] and gait.task.via == []
    assert [stage.task.goal["yaw"] for stage in stages] == pytest.approx([0.2, 0.3, 0.4])
    for before, after in zip(stages, stages[1:]):
        assert after.sample().feet_position[0] == pytest.approx(before.sample().feet_position[-1], abs=1e-9)
    assert gait.to_dict() == stages[2].to_dict() and len(gait.alternatives) == 0
    command = "solve --robot anymal --goal 1,0 --yaw 0.4 --start 0.1,0 --start-yaw 0.1 --via 0.4,0.1 --via 0.7,0 --first --device cpu --out out"
    subprocess.run([program, *command.split()], cwd=tmp_path, check=True, capture_output=True, timeout=300)
    gait.save(tmp_path / "own")
    for stage in ("stage-1", "stage-2", "stage-3"):
        assert sorted(path.name for path in (tmp_path / "own" / stage).iterdir()) == ["result.json", "scenario.toml", "trajectory.json"]
        for name in ("trajectory.json", "scenario.toml"):
            assert (tmp_path / "own" / stage / name).read_text() == (tmp_path / "out" / stage / name).read_text()


def test_a_search_ends_at_the_first_stage_without_a_gait(nowhere: cregopt.Task) -> None:
    route = cregopt.Task(nowhere.robot, nowhere.terrain, goal=(2.0, 0.0), via=[(1.0, 0.0)], force_limit=nowhere.force_limit)
    settings = {"search": {"further_generations": 0, "perturbed_generations": 0}}
    gait = cregopt.search(route, gaits="trot", population=2, generations=0, settings=settings)
    assert not gait.feasible and len(gait.stages) == 1 and gait.task.goal["xy"] == [1.0, 0.0]


def test_saving_into_the_folder_of_an_earlier_gait_warns(gait: cregopt.Gait, tmp_path: pathlib.Path) -> None:
    (tmp_path / "stage-1").mkdir()
    (tmp_path / "stage-1" / "trajectory.json").write_text("{}")
    with pytest.warns(UserWarning, match="stage-1 has the motion of an earlier gait"):
        gait.save(tmp_path)
    assert (tmp_path / "stage-1" / "trajectory.json").read_text() == "{}"


def test_the_result_names_its_built_in_scenario(program: str, tmp_path: pathlib.Path) -> None:
    gait = cregopt.search(cregopt.Task.from_scenario("s1", target=3), first=True, threads=1, device="cpu")
    result = gait.to_dict()
    assert gait.feasible and (result["scenario"], result["target"]) == ("s1", 3)
    command = "solve --scenario s1 --target 3 --first --threads 1 --device cpu --out out"
    subprocess.run([program, *command.split()], cwd=tmp_path, check=True, capture_output=True, timeout=300)
    assert (tmp_path / "out/trajectory.json").read_text() == gait.trajectory.to_json() + "\n"
    assert cregopt.Task.from_scenario(tmp_path / "out/scenario.toml").goal == gait.task.goal


def test_notebooks_show_the_best_candidates_of_an_evaluation(task: cregopt.Task, gait: cregopt.Gait) -> None:
    slower = [[[phase * factor for phase in foot] for foot in gait.schedule] for factor in (1.3, 1.0, 1.15)]
    found = cregopt.evaluate(task, [[[0.1]] * 4, *slower] * 3, device="cpu")
    shown = found._repr_html_()
    order = [int(index) for index in re.findall(r"<tr><td>(\d+)</td>", shown)]
    costs = [float(found.cost[index]) for index in order if found.feasible[index]]
    assert shown.startswith("<p>9 of 12 schedules feasible; the best 10:</p><table>") and len(order) == 10
    assert sorted(order[:9]) == [1, 2, 3, 5, 6, 7, 9, 10, 11] and costs == sorted(costs) and order[9] == 0
    assert f"<td>{costs[0]:.3f}</td><td>{found.horizon[order[0]]:.2f}</td>" in shown
    few = cregopt.evaluate(task, [[[0.1]] * 4], device="cpu")._repr_html_()
    assert few.startswith("<p>0 of 1 schedules feasible</p>") and "<td>0</td><td>no</td><td></td>" in few and "nan" not in few


def test_pictures_and_pages_are_written(gait: cregopt.Gait, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gait.plot(tmp_path / "gait.svg")
    picture = (tmp_path / "gait.svg").read_text()
    assert picture.startswith("<svg") and "trot, " in picture
    shown = re.fullmatch('<img style="max-width: 100%" alt="Gait\\(trot, .*, feasible\\)" src="data:image/svg\\+xml;base64,(.*)"/>', gait._repr_html_())
    assert shown is not None and base64.b64decode(shown[1]).decode() == picture
    assert gait.view(tmp_path / "gait.html") == str(tmp_path / "gait.html")
    assert "trot" in (tmp_path / "gait.html").read_text()
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    path = gait.view()
    assert opened == [f"file://{path}"] and pathlib.Path(path).read_text() == (tmp_path / "gait.html").read_text()
    with pytest.raises(cregopt.Error, match="one that ends in .svg or .png"):
        gait.plot(tmp_path / "gait.gif")
    with pytest.raises(FileNotFoundError, match="cannot write"):
        gait.plot(tmp_path / "missing/gait.svg")
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="cannot make the folder"):
        gait.save(tmp_path / "file/folder")
