"""Evaluations, searches and sweeps on local Ray clusters whose workers and nodes die."""

import importlib.util
import json
import os
import pathlib
import random
import signal
import subprocess
import sys
import threading
import time
from typing import Any, Callable, Iterator, Optional

import cregopt
import numpy as np
import pytest
from cregopt import distributed

COLUMNS = ("feasible", "n_violated", "max_violation", "cost", "iterations", "horizon")
#: Options of a search that takes about 0.1 s.
QUICK: dict[str, Any] = {"gaits": "trot", "population": 2, "generations": 1}


class Machines:
    """Cluster whose nodes have one CPU each."""

    def __init__(self) -> None:
        self.ray = pytest.importorskip("ray")
        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
        # Dead nodes are detected within about 1 s.
        quick = {"health_check_period_ms": 300, "health_check_failure_threshold": 3}
        arguments = {"num_cpus": 1, "_system_config": quick, "object_store_memory": 80 << 20, "include_dashboard": False}
        self.cluster = pytest.importorskip("ray.cluster_utils").Cluster(initialize_head=True, head_node_args=arguments)
        self.ray.init(address=self.cluster.address, log_to_driver=False)

    def add(self) -> Any:
        node = self.cluster.add_node(num_cpus=1, object_store_memory=80 << 20)
        self.cluster.wait_for_nodes()
        return node

    def remove(self, node: Any) -> None:
        self.cluster.remove_node(node, allow_graceful=False)


@pytest.fixture(scope="module")
def machines() -> Iterator[Machines]:
    pytest.importorskip("pyarrow")
    made = Machines()
    yield made
    made.ray.shutdown()
    made.cluster.shutdown()


@pytest.fixture
def two(machines: Machines) -> Iterator[Any]:
    """Second node, added to the cluster for one test."""
    node = machines.add()
    yield node
    if node in machines.cluster.list_all_nodes():
        machines.remove(node)


@pytest.fixture(scope="module")
def population(gait: cregopt.Gait) -> list[list[list[float]]]:
    """22 schedules around that of a gait, and an infeasible one. The chunk sizes in the tests do not divide 23."""
    draw = random.Random(5)
    schedules = []
    for _ in range(22):
        feet = [[phase * draw.uniform(0.9, 1.1) for phase in foot] for foot in gait.schedule]
        schedules.append([[phase * sum(feet[0]) / sum(foot) for phase in foot] for foot in feet])
    return [*schedules, [[0.1] for _ in gait.schedule]]


@pytest.fixture(scope="module")
def alone(task: cregopt.Task, population: list[list[list[float]]]) -> cregopt.Evaluation:
    """Evaluation of the population in one process."""
    found = cregopt.evaluate(task, population, trajectories=True, device="cpu")
    assert found.feasible.any() and not found.feasible.all()
    return found


def assert_same(found: cregopt.Evaluation, alone: cregopt.Evaluation) -> None:
    for name in COLUMNS:
        column, expected = getattr(found, name), getattr(alone, name)
        assert column.dtype == expected.dtype
        np.testing.assert_array_equal(column, expected)


def counting(folder: pathlib.Path, work: str, first_attempt: Callable[[Any], None]) -> Callable[..., object]:
    """Work function that writes a file per attempt, and calls ``first_attempt`` in the first attempt."""

    def attempt(shared: Any, *arguments: Any) -> object:
        from cregopt import distributed

        number = arguments[1] if work == "_search_row" else arguments[0]
        attempts = len(list(folder.glob(f"{number}.*")))
        (folder / f"{number}.{attempts}").write_text(str(os.getpid()))
        if attempts == 0:
            first_attempt(number)
        return getattr(distributed, work)(shared, *arguments)

    return attempt


def attempts(folder: pathlib.Path) -> dict[int, int]:
    """Number of attempts per job, counted by their files."""
    numbers = [int(path.stem) for path in folder.iterdir()]
    return {number: numbers.count(number) for number in numbers}


def test_without_ray_the_error_names_the_package_to_install(task: cregopt.Task, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"pip install cregopt\[ray\]"):
        distributed.evaluate(task, [[[0.5]] * 4])
    with pytest.raises(ImportError, match=r"pip install cregopt\[ray\]"):
        distributed.sweep([task], tmp_path)
    with pytest.raises(ImportError, match=r"pip install cregopt\[ray\]"):
        distributed.search(task)


def test_without_a_cluster_the_error_says_how_to_join_one(task: cregopt.Task, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pytest.importorskip("ray"), "is_initialized", lambda: False)
    with pytest.raises(cregopt.Error, match="no cluster: join one with ray.init"):
        distributed.evaluate(task, [[[0.5]] * 4])
    with pytest.raises(cregopt.Error, match="no cluster: join one with ray.init"):
        distributed.search(task)


@pytest.mark.parametrize("chunk", [1, 7, 100])
def test_one_worker_finds_the_results_of_one_process(
    machines: Machines, task: cregopt.Task, population: list[list[list[float]]], alone: cregopt.Evaluation, chunk: int
) -> None:
    assert_same(distributed.evaluate(task, population, chunk=chunk), alone)


@pytest.mark.parametrize("chunk", [None, 3])
def test_two_workers_find_the_results_of_one_process(
    machines: Machines, two: Any, task: cregopt.Task, population: list[list[list[float]]], alone: cregopt.Evaluation, chunk: Optional[int]
) -> None:
    found = distributed.evaluate(task, population, chunk=chunk, trajectories=True)
    assert_same(found, alone)
    assert found.trajectories == alone.trajectories


def test_no_result_is_lost_when_a_worker_is_killed(
    machines: Machines,
    task: cregopt.Task,
    population: list[list[list[float]]],
    alone: cregopt.Evaluation,
    tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def die(first: int) -> None:
        if first == 10:
            os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(distributed, "_evaluate_chunk", counting(tmp_path, "_evaluate_chunk", die))
    assert_same(distributed.evaluate(task, population, chunk=5), alone)
    assert attempts(tmp_path) == {0: 1, 5: 1, 10: 2, 15: 1, 20: 1}


def test_the_error_names_a_chunk_that_kills_its_workers(
    machines: Machines, task: cregopt.Task, population: list[list[list[float]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(shared: Any, first: int, schedules: Any) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(distributed, "_evaluate_chunk", die)
    with pytest.raises(cregopt.Error, match=r"schedules\[0\] to \[22\]: no result from a worker after 1 retries: WorkerCrashedError"):
        distributed.evaluate(task, population, chunk=50, max_retries=1)


def test_no_result_is_lost_when_a_node_is_removed(
    machines: Machines,
    two: Any,
    task: cregopt.Task,
    population: list[list[list[float]]],
    alone: cregopt.Evaluation,
    tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    attempted, caught = tmp_path / "attempts", tmp_path / "caught"
    attempted.mkdir()
    doomed = two.node_id

    def hang(first: int) -> None:
        import ray

        if ray.get_runtime_context().get_node_id() == doomed and first > 0:
            caught.write_text(str(first))
            time.sleep(60.0)
        # The other node waits, so that some chunks are left for this one.
        for _ in range(1500):
            if first == 0 or caught.exists():
                break
            time.sleep(0.02)

    def remove() -> None:
        while not caught.exists():
            time.sleep(0.02)
        machines.remove(two)

    monkeypatch.setattr(distributed, "_evaluate_chunk", counting(attempted, "_evaluate_chunk", hang))
    removing = threading.Thread(target=remove)
    removing.start()
    try:
        assert_same(distributed.evaluate(task, population, chunk=2), alone)
    finally:
        caught.touch()
        removing.join()
    counts = attempts(attempted)
    assert sorted(counts) == list(range(0, 23, 2)) and counts[int(caught.read_text())] == 2


def test_the_error_names_the_first_invalid_schedule(machines: Machines, task: cregopt.Task, population: list[list[list[float]]]) -> None:
    bad = [*population[:4], [[0.5], [0.5]], *population[4:9], [[-1.0]]]
    with pytest.raises(cregopt.Error) as local:
        cregopt.evaluate(task, bad, device="cpu")
    with pytest.raises(cregopt.Error) as remote:
        distributed.evaluate(task, bad, chunk=3)
    assert str(remote.value) == str(local.value) and str(local.value).startswith("schedules[4]: ")


def test_the_evaluation_of_no_schedules_is_empty(machines: Machines, task: cregopt.Task) -> None:
    assert len(distributed.evaluate(task, [])) == 0


def test_errors_name_invalid_options(machines: Machines, task: cregopt.Task, tmp_path: pathlib.Path) -> None:
    with pytest.raises(cregopt.Error, match="option `threads`: use `cpus`"):
        distributed.evaluate(task, [], threads=2)
    with pytest.raises(cregopt.Error, match="option `device`: use `gpus`"):
        distributed.search(task, device="gpu")
    with pytest.raises(TypeError, match="unexpected keyword argument 'popultion'"):
        distributed.search(task, popultion=2)
    with pytest.raises(cregopt.Error, match="chunk: 0, but it must be an integer from 1"):
        distributed.search(task, chunk=0)
    with pytest.raises(cregopt.Error, match="unknown gait `trott`"):
        distributed.search(task, gaits="trott")
    with pytest.raises(cregopt.Error, match="gpus: 2, but it must be a number from 0 to 1"):
        distributed.search(task, gpus=2)
    with pytest.raises(cregopt.Error, match="option `seed`: use `seeds`"):
        distributed.sweep([task], tmp_path, seed=2)
    with pytest.raises(TypeError, match="unexpected keyword argument 'popultion'"):
        distributed.sweep([task], tmp_path, popultion=2)
    with pytest.raises(cregopt.Error, match="chunk: 0, but it must be an integer from 1"):
        distributed.evaluate(task, [], chunk=0)
    with pytest.raises(cregopt.Error, match="unknown table of settings `serch`"):
        distributed.evaluate(task, [[[0.5]] * 4], settings={"serch": {}})
    assert list(tmp_path.iterdir()) == []


def assert_same_search(found: cregopt.Gait, alone: cregopt.Gait) -> None:
    """Asserts that two searches are equal except for times and device."""
    assert len(found.stages) == len(alone.stages)
    for stage, expected in zip(found.stages, alone.stages):
        assert stage.trajectory.to_json() == expected.trajectory.to_json()
        assert plain(stage.to_dict()) == plain(expected.to_dict())


def plain(result: Any) -> Any:
    """Result without times and device."""
    if isinstance(result, dict):
        return {key: plain(value) for key, value in result.items() if key not in ("seconds", "first_feasible_seconds", "device")}
    return [plain(value) for value in result] if isinstance(result, list) else result


#: Search of several generations in which f32 does not solve every candidate. The closing in f64 solves some of the others.
BROAD: dict[str, Any] = {"seed": 3, "gaits": "trot,pace,bound", "population": 24, "generations": 2, "alternatives": 2}
BROAD["settings"] = {"solver": {"max_iterations": 7}}


@pytest.fixture(scope="module")
def searched(task: cregopt.Task) -> cregopt.Gait:
    """Gait of the broad search in one process."""
    gait = cregopt.search(task, device="cpu", **BROAD)
    generations = gait.to_dict()["generations"]
    assert gait.feasible and len(gait.alternatives) == 1 and any(g["feasible"] < g["evaluated"] for g in generations)
    return gait


def test_the_work_of_workers_yields_the_search_of_one_process(task: cregopt.Task, searched: cregopt.Gait) -> None:
    """The work of the workers runs in this process, without a cluster."""
    from cregopt import _cregopt, _search

    def solve(task: cregopt.Task, job: str, schedules: Any) -> Iterator[tuple[int, Any]]:
        for first in range(0, len(schedules), 5):
            yield first, _cregopt.solve_chunk(task, job, schedules[first : first + 5], "cpu", 1)

    found = _cregopt.search(task, _search.scenario_options(**BROAD), None, ("cpu", "workers", solve))
    assert_same_search(found, searched)
    assert found.to_dict().get("fallback") is None

    def without_gpu(task: cregopt.Task, job: str, schedules: Any) -> Iterator[tuple[int, Any]]:
        for first, (answers, _) in solve(task, job, schedules):
            yield first, (answers, (len(answers), "the device was lost"))

    found = _cregopt.search(task, _search.scenario_options(**BROAD), None, ("cpu", "workers", without_gpu))
    assert found.trajectory.to_json() == searched.trajectory.to_json()
    fallback = found.to_dict()["fallback"]
    assert fallback["candidates"] >= 24 and fallback["reason"] == "the device was lost"


@pytest.mark.parametrize("chunk", [None, 1, 3])
def test_a_search_on_one_worker_equals_that_of_one_process(machines: Machines, task: cregopt.Task, searched: cregopt.Gait, chunk: Optional[int]) -> None:
    records: list[dict[str, Any]] = []
    found = distributed.search(task, chunk=chunk, progress=records.append, **BROAD)
    assert_same_search(found, searched)
    assert [g["generation"] for g in records if g["event"] == "generation"] == [g["generation"] for g in found.to_dict()["generations"]]
    assert found.to_dict()["device"] == "cpu, Ray's workers of 1 threads, f32 closed in f64"


def test_a_search_on_two_workers_equals_that_of_one_process(machines: Machines, two: Any, task: cregopt.Task, searched: cregopt.Gait) -> None:
    assert_same_search(distributed.search(task, **BROAD), searched)
    exact: dict[str, Any] = {"gaits": "trot", "population": 3, "generations": 1, "precision": "f64", "first": True, "smooth": True}
    assert_same_search(distributed.search(task, **exact), cregopt.search(task, device="cpu", **exact))
    schedule: dict[str, Any] = {"gaits": searched.schedule, "population": 3, "generations": 1, "settings": {"solver": {"max_iterations": 60}}}
    assert_same_search(distributed.search(task, **schedule), cregopt.search(task, device="cpu", **schedule))


def test_stages_and_diagnoses_equal_those_of_one_process(machines: Machines, two: Any, task: cregopt.Task, nowhere: cregopt.Task) -> None:
    route = cregopt.Task(task.robot, task.terrain, goal=(1.0, 0.1), yaw=0.3, start=(0.1, 0.0), start_yaw=0.1, via=[(0.5, 0.1)])
    found = distributed.search(route, **QUICK)
    assert len(found.stages) == 2
    assert_same_search(found, cregopt.search(route, device="cpu", **QUICK))
    # A diagnosis searches with modified tasks and settings.
    none = {**QUICK, "settings": {"search": {"further_generations": 0, "perturbed_generations": 0}}}
    found = distributed.search(nowhere, **none)
    assert found.diagnosis is not None and found.diagnosis["relaxations"]
    assert_same_search(found, cregopt.search(nowhere, device="cpu", **none))


def test_workers_reject_invalid_schedules(task: cregopt.Task, drawn: cregopt.Gait) -> None:
    from cregopt import _cregopt

    job = json.dumps({"lower": drawn.to_dict()["lower"], "certified": False})
    (answer,), left = _cregopt.solve_chunk(task, job, [drawn.schedule], "cpu", 1)
    assert answer[0] == "solved" and len(answer[5]) > 500 and left is None
    uneven = [[*drawn.schedule[0][:-1], drawn.schedule[0][-1] - 0.01], *drawn.schedule[1:]]
    with pytest.raises(cregopt.Error, match="durations, foot 0: .* s in all, but it must be"):
        _cregopt.solve_chunk(task, job, [uneven], "cpu", 1)
    with pytest.raises(cregopt.Error, match="2 feet, but it must be 4 feet"):
        _cregopt.solve_chunk(task, job, [drawn.schedule[:2]], "cpu", 1)


def test_a_search_loses_no_result_when_a_worker_is_killed(
    machines: Machines, task: cregopt.Task, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(first: int) -> None:
        if first == 2:
            os.kill(os.getpid(), signal.SIGKILL)

    # All jobs are then candidates of generations.
    as_drawn = {**BROAD, "settings": {**BROAD["settings"], "search": {"duration_steps": 0}}}
    searched = cregopt.search(task, device="cpu", **as_drawn)
    monkeypatch.setattr(distributed, "_solve_chunk", counting(tmp_path, "_solve_chunk", die))
    assert_same_search(distributed.search(task, chunk=2, **as_drawn), searched)
    sizes = [generation["evaluated"] for generation in searched.to_dict()["generations"]]
    expected = {first: sum(first < size for size in sizes) + (first == 2) for first in range(0, max(sizes), 2)}
    assert attempts(tmp_path) == expected


def test_a_search_ends_with_an_error_when_its_workers_die(machines: Machines, task: cregopt.Task, monkeypatch: pytest.MonkeyPatch) -> None:
    def die(shared: Any, first: int, schedules: Any) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(distributed, "_solve_chunk", die)
    with pytest.raises(cregopt.Error, match=r"schedules\[0\] to \[0\]: no result from a worker after 0 retries: WorkerCrashedError"):
        distributed.search(task, max_retries=0, **QUICK)


def test_a_search_ends_by_an_exception_or_an_interrupt(machines: Machines, task: cregopt.Task, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def enough(record: dict[str, Any]) -> None:
        raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        distributed.search(task, progress=enough, **BROAD)

    begun, ended = tmp_path / "begun", tmp_path / "ended"

    def hang(shared: Any, first: int, schedules: Any) -> None:
        # Background jobs ignore interrupts by default. The same applies below.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            begun.touch()
            for _ in range(3000):
                time.sleep(0.02)
        except KeyboardInterrupt:
            ended.touch()
            raise

    def interrupt() -> None:
        while not begun.exists():
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(distributed, "_solve_chunk", hang)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    interrupting = threading.Thread(target=interrupt)
    interrupting.start()
    start = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            distributed.search(task, **QUICK)
    finally:
        interrupting.join()
        signal.signal(signal.SIGINT, before)
    while not ended.exists() and time.monotonic() - start < 30.0:
        time.sleep(0.02)
    assert ended.exists()  # the worker has ended as well, so that the cluster is free


def test_gpu_workers_run_on_nodes_with_a_gpu(
    machines: Machines, task: cregopt.Task, population: list[list[list[float]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = machines.cluster.add_node(num_cpus=1, num_gpus=1, object_store_memory=80 << 20)
    machines.cluster.wait_for_nodes()
    place = node.node_id

    def solve(shared: Any, first: int, schedules: Any) -> object:
        import ray

        return f"{ray.get_runtime_context().get_node_id() == place} {shared[3] if len(shared) == 5 else shared[2]['device']}"

    monkeypatch.setattr(distributed, "_solve_chunk", solve)
    monkeypatch.setattr(distributed, "_evaluate_chunk", solve)
    try:
        with pytest.raises(cregopt.Error, match="^True gpu$"):
            distributed.search(task, gpus=1, **QUICK)
        with pytest.raises(cregopt.Error, match="^True gpu$"):
            distributed.evaluate(task, population, gpus=0.5)
    finally:
        machines.remove(node)


def rows(table: Any) -> list[dict[str, Any]]:
    """Rows without the columns that depend on the machine."""
    return [{name: value for name, value in row.items() if name != "seconds"} for row in table.to_pylist()]


def test_a_sweep_finds_the_gaits_of_searches_and_can_be_resumed(
    machines: Machines, two: Any, task: cregopt.Task, tmp_path: pathlib.Path
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    refused = cregopt.Task(task.robot, task.terrain, goal=(1.0, 0.0, 0.9))
    tasks = {"turn": task, "refused": refused, "short": cregopt.Task(task.robot, task.terrain, goal=(0.5, 0.0))}
    quick = {**QUICK, "settings": {"search": {"further_generations": 0, "perturbed_generations": 0}}}
    reported: list[dict[str, Any]] = []

    def sweep(folder: str, **options: Any) -> list[dict[str, Any]]:
        reported.clear()
        return rows(distributed.sweep(tasks, tmp_path / folder, seeds=[1, 2], trajectories=True, **{**quick, "progress": reported.append, **options}))

    def enough(row: dict[str, Any]) -> None:
        reported.append(row)
        if len(reported) == 3:
            raise LookupError("enough")

    whole = sweep("whole")
    assert [(row["task"], row["seed"]) for row in whole] == [(name, seed) for name in tasks for seed in (1, 2)] and len(reported) == 6
    for row in whole:
        if row["task"] == "refused":
            assert row["error"].startswith("Error: ") and "goal" in row["error"] and row["feasible"] is None
            continue
        gait = cregopt.search(tasks[row["task"]], seed=row["seed"], device="cpu", **quick)
        assert row["error"] is None and row["feasible"] and gait.feasible
        assert json.loads(row["durations"]) == gait.schedule and row["horizon"] == gait.trajectory.horizon
        assert gait.cost is not None and row["cost"] == gait.cost["total"]
        assert row["family"] == gait.family and row["objective"] == "transport"
        assert [kept["trajectory"] for kept in reported if kept["key"] == row["key"]] == [gait.trajectory.to_json()]
    files = parquet.read_table(tmp_path / "whole").to_pylist()
    assert sorted(row["key"] for row in files) == sorted(row["key"] for row in whole)

    # Interrupted, with one worker: the reported rows are stored, and the next sweep adds the others.
    machines.remove(two)
    with pytest.raises(LookupError, match="enough"):
        sweep("parts", progress=enough)
    kept = {row["key"] for row in reported if row["error"] is None}
    assert {row["key"] for row in parquet.read_table(tmp_path / "parts").to_pylist()} == {row["key"] for row in reported}
    (tmp_path / "parts/.part-0.parquet.tmp").write_bytes(b"PAR1")
    assert sweep("parts") == whole
    assert {row["key"] for row in reported} == {row["key"] for row in whole} - kept
    # Only the failed searches run again, and each has one row.
    assert sweep("parts") == whole and {row["task"] for row in reported} == {"refused"}
    # An incomplete file is deleted, and its searches run again.
    torn = max((tmp_path / "parts").glob("part-*"), key=lambda path: path.stat().st_size)
    lost = parquet.read_table(torn).num_rows
    torn.write_bytes(torn.read_bytes()[:-20])
    with pytest.warns(UserWarning, match="dropped, because it cannot be read"):
        assert sweep("parts") == whole
    assert len(reported) == lost + 2
    files = parquet.read_table(tmp_path / "parts").to_pylist()
    assert sorted(row["key"] for row in files) == sorted(row["key"] for row in whole)
    parquet.write_table(parquet.read_table(torn.parent).select(["key"]), torn.parent / "part-other.parquet")
    with pytest.raises(cregopt.Error, match="part-other.parquet: columns .*choose another folder"):
        sweep("parts")


def test_a_task_without_a_feasible_gait_has_a_row(
    machines: Machines, nowhere: cregopt.Task, tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    none = {**QUICK, "settings": {"search": {"further_generations": 0, "perturbed_generations": 0}}}
    (row,) = rows(distributed.sweep([nowhere], tmp_path, **none))
    nearest = cregopt.search(nowhere, device="cpu", **none)
    if importlib.util.find_spec("tqdm"):
        distributed.sweep([nowhere], tmp_path, progress=True, **none)
        assert "1/1" in capsys.readouterr().err
    assert row["feasible"] is False and row["cost"] is None and row["error"] is None
    assert json.loads(row["durations"]) == nearest.schedule and row["horizon"] == nearest.trajectory.horizon


def test_a_sweep_continues_when_workers_die(
    machines: Machines, task: cregopt.Task, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempted = tmp_path / "attempts"
    attempted.mkdir()

    def search(shared: Any, task: cregopt.Task, seed: int) -> object:
        from cregopt import distributed

        number = len(list(attempted.iterdir()))
        (attempted / f"{seed}.{number}").touch()
        if seed == 2 or (seed == 3 and len(list(attempted.glob("3.*"))) == 1):
            os.kill(os.getpid(), signal.SIGKILL)
        return distributed._search_row(shared, task, seed)

    monkeypatch.setattr(distributed, "_search_row", search)
    found = rows(distributed.sweep([task], tmp_path / "sweep", seeds=[1, 2, 3], max_retries=1, **QUICK))
    assert attempts(attempted) == {1: 1, 2: 2, 3: 2}
    assert [row["feasible"] for row in found] == [True, None, True]
    assert found[1]["error"].startswith("no result from a worker after 1 retries: WorkerCrashedError")
    monkeypatch.undo()
    again = rows(distributed.sweep([task], tmp_path / "sweep", seeds=[1, 2, 3], max_retries=1, **QUICK))
    assert [row["error"] for row in again] == [None] * 3 and [again[0], again[2]] == [found[0], found[2]]


SPEC = """
count = 10
shard = 4
length = 1.0
robots = ["biped", "own.toml"]
families = ["run", "trot"]
[[grounds]]
terrain = "flat"
x = [0.0, 0.5]
[[commands]]
forward = [0.1, 0.3]
"""


def files_of(folder: pathlib.Path) -> dict[str, bytes]:
    """Files of a data set."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.suffix != ".lock" and path.is_file()}


def test_a_data_set_of_workers_equals_that_of_one_process(machines: Machines, two: Any, program: str, tmp_path: pathlib.Path) -> None:
    cregopt.Robot("anymal").save(tmp_path / "own.toml")
    spec = tmp_path / "spec.toml"
    spec.write_text(SPEC)
    made = subprocess.run([program, "dataset", spec, "--out", tmp_path / "alone", "--device", "cpu"], capture_output=True, text=True, timeout=120)
    if "unrecognized subcommand" in made.stderr:
        pytest.skip("the program was built without data sets")
    assert made.returncode == 0, made.stderr
    seen: list[tuple[int, int]] = []

    def interrupted(done: int, asked: int) -> None:
        seen.append((done, asked))
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        distributed.dataset(spec, tmp_path / "data", progress=interrupted)
    assert len(seen) == 1 and 0 < seen[0][0] < seen[0][1] == 10
    # A second call continues.
    manifest = distributed.dataset(spec, tmp_path / "data", progress=lambda done, asked: seen.append((done, asked)))
    assert manifest["complete"] and seen[-1] == (10, 10)
    assert sum(shard["motions"] for shard in manifest["shards"]) == 10
    assert files_of(tmp_path / "data") == files_of(tmp_path / "alone")


def test_errors_of_data_sets_name_place_and_value(machines: Machines, tmp_path: pathlib.Path) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text(SPEC.replace("count = 10", "count = 0"))
    with pytest.raises(cregopt.Error, match=r"spec.toml: count: 0"):
        distributed.dataset(spec, tmp_path / "data")
