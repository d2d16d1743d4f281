"""Searches, populations and sweeps on many machines, by Ray: ``pip install cregopt[ray]``.

>>> import ray
>>> from cregopt import distributed
>>> ray.init(address="auto")  # a cluster; ``ray.init()`` makes one of this machine
>>> gait = distributed.search(task, seed=1, population=256)
>>> found = distributed.evaluate(task, schedules)
>>> table = distributed.sweep(tasks, "sweep", seeds=range(1, 6))

Every node needs this package, of the same version. What workers find on CPUs does not depend on how many they are, nor on how work is cut, as long
as the processors have the same vector instructions. Work of a process or a node that dies is done again by another.

:func:`search` splits each generation over the workers. Generations follow one another, so that workers wait at the end of each: with as many
candidates a generation as there are workers, or a few times as many, they wait least. The searches of a :func:`sweep` do not wait for one another.

With ``gpus`` workers solve on GPUs, as ``device="gpu"`` does in one process. Results then are the same for the same adapter and driver alone, and
where these are what one process has. Ray counts GPUs, but says nothing to Vulkan: on a node with several all workers take the same one.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import itertools
import json
import pathlib
import re
import time
import uuid
import warnings
from typing import Any, Callable, Iterable, Iterator, Mapping, NamedTuple, Optional, Sequence, Union

import numpy as np

from . import _cregopt, _search
from ._cregopt import Error, Evaluation, Gait, Task, __version__
from ._pickle import parts
from ._search import Path, Progress, Schedule

__all__ = ["evaluate", "search", "sweep"]

#: Candidates of a chunk at most, without GPUs and with: what is solved again when a worker dies. A GPU is not faster with more.
_LARGEST_CHUNK = (256, 8192)
#: Chunks for each worker: the last ones to end keep the others waiting for a part of a chunk's time. A GPU is opened for each.
_CHUNKS_A_WORKER = (4, 1)
#: How long a search waits before it asks whether it is to go on, s.
_PATIENCE = 0.05
#: Rows are written when they are as many, or as old in s.
_ROWS, _AGE = 256, 10.0


def evaluate(
    task: Task,
    schedules: Sequence[Schedule],
    *,
    chunk: Optional[int] = None,
    cpus: int = 1,
    gpus: float = 0,
    max_retries: int = 3,
    trajectories: bool = False,
    **options: Any,
) -> Evaluation:
    """Solves and certifies given schedules on a cluster, as :func:`cregopt.evaluate` does in one process.

    Parameters
    ----------
    task : Task
        Without places on the way.
    schedules : list of schedules
        Each a list of phase durations for each foot, s: stance, swing, stance, ...
    chunk : int, optional
        Schedules that a worker gets at once; by default a quarter of its share, and at most 256 (on GPUs all of it, and at most 8192). Results
        do not depend on it.
    cpus : int, default 1
        CPUs of a worker: what it asks Ray for, and its threads. On many nodes more are faster: there are fewer chunks to hand out, at 0.7 ms each.
    gpus : float, default 0
        GPUs of a worker, 1 or a part of one that workers share: what it asks Ray for. Not 0: it solves on a GPU.
    max_retries : int, default 3
        How often a chunk is given to another worker when a process or a node dies.
    trajectories : bool, default False
        Whether motions are returned, too; each is some 70 kB on the network.
    **options
        ``smooth``, ``transcription``, ``precision`` and ``settings`` of :func:`cregopt.evaluate`.

    Returns
    -------
    Evaluation
        Arrays of shape (n,) in the order of the schedules, bit for bit those of :func:`cregopt.evaluate` with ``device="cpu"``.

    Raises
    ------
    ImportError
        Without Ray.
    Error
        Without a cluster; for what :func:`cregopt.evaluate` does not take, of several schedules the first; and where the workers of a chunk died
        ``max_retries + 1`` times.
    """
    _check_options(_search.evaluate, (task, schedules), options)
    cluster = _Cluster(cpus, gpus, max_retries)
    chunk = cluster.chunk(chunk, len(schedules))
    if len(schedules) == 0:
        return _search.evaluate(task, schedules, trajectories=trajectories, device="cpu", **options)
    shared = (task, {**options, "trajectories": trajectories, "device": cluster.device, "threads": cpus})
    found: dict[int, Evaluation] = {}
    refused: dict[int, str] = {}
    for first, outcome in cluster.chunks(_evaluate_chunk, shared, schedules, chunk):
        if isinstance(outcome, str):
            refused[first] = outcome
        else:
            found[first] = outcome
        # What stands behind the first that does not fit need not be solved.
        if refused and all(before in found for before in range(0, min(refused), chunk)):
            break
    if refused:
        raise Error(refused[min(refused)])
    return _joined([found[first] for first in sorted(found)])


def search(
    task: Task,
    *,
    seed: int = 1,
    chunk: Optional[int] = None,
    cpus: int = 1,
    gpus: float = 0,
    max_retries: int = 3,
    progress: Optional[Progress] = None,
    **options: Any,
) -> Gait:
    """Searches for the cheapest gait of a task, as :func:`cregopt.search` does, with each generation solved on a cluster.

    This process draws the schedules, certifies what comes back and ranks it; ``refine`` runs here, too. Other threads of Python go on meanwhile;
    Ctrl-C ends it with ``KeyboardInterrupt``, and what the workers are at with it.

    Parameters
    ----------
    task : Task
        Each leg of a way with places on it is searched in turn.
    seed : int, default 1
        Seed of all random numbers.
    chunk : int, optional
        Schedules that a worker gets at once; by default a quarter of its share, and at most 256 (on GPUs all of it, and at most 8192). Results
        do not depend on it.
    cpus : int, default 1
        CPUs of a worker: what it asks Ray for, and its threads.
    gpus : float, default 0
        GPUs of a worker, 1 or a part of one that workers share: what it asks Ray for. Not 0: it solves on a GPU.
    max_retries : int, default 3
        How often a chunk is given to another worker when a process or a node dies.
    progress : callable, optional
        As :func:`cregopt.search` has it.
    **options
        The others of :func:`cregopt.search`, but for ``threads`` and ``device``. A ``population`` of a few candidates for each worker keeps a
        cluster busy; the default of 16 does so for four.

    Returns
    -------
    Gait
        Bit for bit that of :func:`cregopt.search` with ``device="cpu"``, but for times and for the name of the device in ``to_dict()``.

    Raises
    ------
    ImportError
        Without Ray.
    Error
        Without a cluster; for what :func:`cregopt.search` does not take; and where the workers of a chunk died ``max_retries + 1`` times.
    """
    _check_options(_search.search, (task,), options)
    cluster = _Cluster(cpus, gpus, max_retries)
    if chunk is not None:
        _at_least("chunk", chunk, 1)

    def solve(task: Task, settings: str, schedules: Sequence[Schedule]) -> Iterator[Optional[tuple[int, list[Any]]]]:
        shared = (task, settings, cluster.device, cpus)
        for first, outcome in cluster.chunks(_solve_chunk, shared, schedules, cluster.chunk(chunk, len(schedules)), patience=_PATIENCE):
            if isinstance(outcome, str):
                raise Error(outcome)
            yield None if first is None else (first, outcome)

    name = f"{cluster.device}, Ray's workers of {cpus} threads"
    return _cregopt.search(task, _search.asked(seed=seed, **options), progress, (name, solve))


def sweep(
    tasks: Union[Sequence[Task], Mapping[str, Task]],
    folder: Path,
    *,
    seeds: Iterable[int] = (1,),
    cpus: int = 1,
    gpus: float = 0,
    max_retries: int = 3,
    trajectories: bool = False,
    progress: Optional[Callable[[dict[str, Any]], object]] = None,
    **options: Any,
) -> Any:
    """Searches for the gaits of many tasks on a cluster, and keeps what is found in a folder of Parquet files.

    A search that the folder has is not run again: a sweep that ended early goes on where it was, and one with more tasks or seeds runs those that
    are new. A search is the same when task, name, seed, options and version are. Files are written whole, every 10 s or 256 rows; those that
    cannot be read are dropped with a warning. One sweep at a time may use a folder.

    Parameters
    ----------
    tasks : list of Task, or dict of str to Task
        Tasks, and their names; in a list these are ``0``, ``1``, ...
    folder : path
        Where rows are kept, made if need be; ``pyarrow.parquet.read_table(folder)`` reads all of it, in the order in which searches ended.
    seeds : list of int, default (1,)
        Seeds; each task is searched with each.
    cpus : int, default 1
        CPUs of a worker: what it asks Ray for, and its threads.
    gpus : float, default 0
        GPUs of a worker, 1 or a part of one that workers share: what it asks Ray for. Not 0: it solves on a GPU.
    max_retries : int, default 3
        How often a search is begun again when its process or node dies.
    trajectories : bool, default False
        Whether motions are kept, too: the column ``trajectory``, the text of trajectory.json, some 50 kB each.
    progress : callable, optional
        Is called with each new row, a dictionary. An exception in it ends the sweep and is raised; what was found is kept.
    **options
        As :func:`cregopt.search` has them, but for ``seed``, ``threads``, ``device`` and ``progress``. With ``seconds`` rows depend on the machine.

    Returns
    -------
    pyarrow.Table
        A row for each task and seed, in their order, the same at any number of workers but for ``seconds``. Columns:

        ===============  =======  ==============================================================================================================
        ``key``          string   says which search it is
        ``task``         string   name of the task
        ``seed``         int64
        ``feasible``     bool     whether the certificate holds; without, the row is of the candidate that violates least
        ``family``       string   family of the gait, if it has one
        ``cost``         float64  cost a weight and distance; null where it is not feasible
        ``objective``    string   what was best
        ``horizon``      float64  time from the start to the end, s
        ``seconds``      float64  time of the search, s; of all legs
        ``durations``    string   the schedule in JSON: a list for each foot, s, stance, swing, stance, ...
        ``error``        string   why there is no result, and null where there is one: such a row is run again by the next sweep
        ===============  =======  ==============================================================================================================

        The files have ``trajectory`` besides. Of a task with places on the way the row is of the last leg, as :func:`cregopt.search` has it.

    Raises
    ------
    ImportError
        Without Ray or pyarrow.
    Error
        Without a cluster, for options that no search has, and where workers cannot run at all. A search that fails makes a row with its ``error``.
    """
    _check_options(_search.search, (None,), options, seed="`seeds` is for that")
    cluster = _Cluster(cpus, gpus, max_retries)
    named = tasks.items() if isinstance(tasks, Mapping) else ((str(number), task) for number, task in enumerate(tasks))
    given = {name: value for name, value in options.items() if value is not None}
    what = {"version": __version__, "options": given, "trajectories": trajectories}
    if gpus:
        what["device"] = cluster.device
    jobs: dict[str, _Job] = {}
    every_seed = [int(seed) for seed in seeds]
    for name, task in named:
        told = {**what, "task": parts(task), "name": name}
        jobs.update((_key({**told, "seed": seed}), _Job(name, seed, task)) for seed in every_seed)
    store = _Store(pathlib.Path(folder))
    rows = store.open(jobs)
    work = cluster.remote(_search_row)
    shared = cluster.ray.put((__version__, {**given, "device": cluster.device, "threads": cpus}, trajectories))
    try:
        for key, outcome in cluster.each(lambda key: work.remote(shared, jobs[key].task, jobs[key].seed), [key for key in jobs if key not in rows]):
            if isinstance(outcome, cluster.ray.exceptions.RayTaskError):
                raise Error(f"task {jobs[key].name}, seed {jobs[key].seed}: {cluster.why(outcome)}") from outcome
            result = {"error": cluster.why(outcome)} if isinstance(outcome, Exception) else outcome
            row = {**store.blank, "key": key, "task": jobs[key].name, "seed": jobs[key].seed, **result}
            store.add(row)
            rows[key] = {name: value for name, value in row.items() if name != "trajectory"}
            if progress is not None:
                progress(row)
    finally:
        store.flush()
    return store.table([rows[key] for key in jobs])


class _Job(NamedTuple):
    """A search of a sweep."""

    name: str
    seed: int
    task: Task


# What workers run. They tell errors as values, so that a sweep goes on and that of the first schedule is raised.


def _same_version(version: str) -> None:
    if version != __version__:
        raise RuntimeError(f"cregopt {__version__} on a worker, but {version} where it was asked: install the same on every node")


def _evaluate_chunk(shared: tuple[str, Task, dict[str, Any]], first: int, schedules: Sequence[Schedule]) -> Union[Evaluation, str]:
    """A chunk of schedules, of which the first has this index."""
    version, task, options = shared
    _same_version(version)
    try:
        return _search.evaluate(task, schedules, **options)
    except Error as error:
        return re.sub(r"^schedules\[(\d+)\]", lambda found: f"schedules[{first + int(found[1])}]", str(error))


def _solve_chunk(shared: tuple[str, Task, str, str, int], first: int, schedules: Sequence[Schedule]) -> Union[list[Any], str]:
    """A chunk of a search's schedules, of which the first has this index: solved, and not yet certified."""
    version, task, settings, device, threads = shared
    _same_version(version)
    try:
        return _cregopt.solve_chunk(task, settings, schedules, device, threads)
    except Error as error:
        return str(error)


def _search_row(shared: tuple[str, dict[str, Any], bool], task: Task, seed: int) -> dict[str, Any]:
    """What a row says of its search."""
    version, options, trajectories = shared
    _same_version(version)
    try:
        gait = _search.search(task, seed=seed, **options)
        return {
            "feasible": gait.feasible,
            "family": gait.family,
            "cost": gait.cost["total"] if gait.cost else None,
            "objective": gait.to_dict()["search"]["objective"],
            "horizon": gait.trajectory.horizon,
            "seconds": sum(leg.seconds for leg in gait.legs),
            "durations": json.dumps(gait.schedule),
            "trajectory": gait.trajectory.to_json() if trajectories else None,
        }
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a panic of the compiled part is no Exception
        return {"error": f"{type(error).__name__}: {error}"}


class _Cluster:
    """Workers of a number of CPUs and GPUs on the cluster that this process has joined."""

    def __init__(self, cpus: int, gpus: float, max_retries: int) -> None:
        _at_least("cpus", cpus, 1)
        _at_least("max_retries", max_retries, 0)
        if not isinstance(gpus, (int, float)) or not (0 <= gpus < 1 or gpus == 1):
            raise Error(f"gpus: {gpus}, but it must be a number from 0 to 1: a worker solves on one GPU at most")
        self.ray = _needed("ray")
        if not self.ray.is_initialized():
            raise Error('no cluster: join one by ray.init(address="auto"), or make one of this machine by ray.init()')
        self.cpus, self.gpus, self.max_retries = cpus, gpus, max_retries
        self.device = "gpu" if gpus else "cpu"
        for name, asked in (("CPU", cpus), ("GPU", gpus)):
            largest = max((node["Resources"].get(name, 0.0) for node in self.ray.nodes() if node["Alive"]), default=0.0)
            if asked > largest:
                told = f"{name.lower()}s: {asked}, but the largest node of the cluster has {largest:.0f}: waiting for one with more"
                warnings.warn(told, stacklevel=3)

    def workers(self) -> int:
        """How many can work at once now."""
        there = self.ray.cluster_resources()
        places = there.get("CPU", 0.0) // self.cpus
        return max(1, int(min(places, there.get("GPU", 0.0) // self.gpus) if self.gpus else places))

    def remote(self, work: Callable[..., object]) -> Any:
        return self.ray.remote(num_cpus=self.cpus, num_gpus=self.gpus, max_retries=self.max_retries)(work)

    def chunk(self, asked: Optional[int], n: int) -> int:
        """How many of n schedules a worker gets at once."""
        if asked is not None:
            _at_least("chunk", asked, 1)
            return asked
        on_gpus = self.device == "gpu"
        share = -(-n // (_CHUNKS_A_WORKER[on_gpus] * self.workers()))
        return max(self.cpus, min(share, _LARGEST_CHUNK[on_gpus]))

    def chunks(
        self, work: Callable[..., object], shared: tuple[Any, ...], schedules: Sequence[Schedule], chunk: int, patience: Optional[float] = None
    ) -> Iterator[tuple[Any, Any]]:
        """Schedules in chunks: the index of the first of each with what the worker returned, as they end. As :meth:`each`."""
        remote, known = self.remote(work), self.ray.put((__version__, *shared))
        firsts = range(0, len(schedules), chunk)
        for first, outcome in self.each(lambda first: remote.remote(known, first, schedules[first : first + chunk]), firsts, patience):
            if isinstance(outcome, Exception):
                last = min(first + chunk, len(schedules)) - 1
                raise Error(f"schedules[{first}] to [{last}]: {self.why(outcome)}") from outcome
            yield first, outcome

    def each(self, submit: Callable[[Any], Any], jobs: Iterable[Any], patience: Optional[float] = None) -> Iterator[tuple[Any, Any]]:
        """Each job once, with its result or Ray's exception, as they end. Some are submitted ahead, so that workers need not wait.

        Where none ends for as long as ``patience``, s, there is a pair of None in between. What is not waited for any more is called off.
        """
        ray, jobs = self.ray, iter(jobs)
        pending: dict[Any, Any] = {}
        try:
            while True:
                ahead = 2 * self.workers() + 2 - len(pending)
                pending.update((submit(job), job) for job in itertools.islice(jobs, max(0, ahead)))
                if not pending:
                    return
                ray.wait(list(pending), num_returns=1, timeout=patience)
                ready, _ = ray.wait(list(pending), num_returns=len(pending), timeout=0)
                if not ready:
                    yield None, None
                for reference in ready:
                    job = pending.pop(reference)
                    try:
                        outcome = ray.get(reference)
                    except ray.exceptions.RayError as error:
                        outcome = error
                    yield job, outcome
        finally:
            for reference in pending:
                ray.cancel(reference)

    def why(self, error: Exception) -> str:
        """What Ray's exception says, without the stack of the worker."""
        if isinstance(error, self.ray.exceptions.RayTaskError):
            return f"a worker could not run: {getattr(error, 'cause', error)}"
        lines = str(error).strip().splitlines() or [""]
        return f"no result of a worker, with {self.max_retries} retries: {type(error).__name__}: {lines[0]}"


class _Store:
    """The rows of a folder. Those with an error stand in files of their own, which the next sweep writes anew."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.arrow, self.parquet = _needed("pyarrow"), _needed("pyarrow.parquet")
        text, number = self.arrow.string(), self.arrow.float64()
        kinds = {"key": text, "task": text, "seed": self.arrow.int64(), "feasible": self.arrow.bool_(), "family": text, "cost": number}
        kinds.update({"objective": text, "horizon": number, "seconds": number, "durations": text, "error": text, "trajectory": text})
        self.schema = self.arrow.schema(list(kinds.items()))
        self.columns = [name for name in kinds if name != "trajectory"]
        self.blank: dict[str, Any] = dict.fromkeys(kinds)
        self.folder = folder
        self.rows: list[dict[str, Any]] = []
        self.written = time.monotonic()

    def open(self, jobs: Mapping[str, object]) -> dict[str, dict[str, Any]]:
        """The results that are there for jobs, by their keys."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for left in self.folder.glob(".*.parquet.tmp"):
            left.unlink()
        there = {row["key"]: row for path in self.folder.glob("part-*.parquet") for row in self._read(path) if row["key"] in jobs}
        failed = list(self.folder.glob("failed-*.parquet"))
        self._write("failed", [row for path in failed for row in self._read(path) if row["key"] not in jobs])
        for path in failed:
            path.unlink(missing_ok=True)
        return there

    def add(self, row: dict[str, Any]) -> None:
        self.rows.append(row)
        if len(self.rows) >= _ROWS or time.monotonic() - self.written > _AGE:
            self.flush()

    def flush(self) -> None:
        rows, self.rows, self.written = self.rows, [], time.monotonic()
        self._write("part", [row for row in rows if row["error"] is None])
        self._write("failed", [row for row in rows if row["error"] is not None])

    def table(self, rows: list[dict[str, Any]]) -> Any:
        return self.arrow.Table.from_pylist(rows, schema=self.arrow.schema([self.schema.field(name) for name in self.columns]))

    def _read(self, path: pathlib.Path) -> list[dict[str, Any]]:
        try:
            with open(path, "rb") as file:
                schema = self.parquet.read_schema(file)
                if schema.equals(self.schema):
                    rows: list[dict[str, Any]] = self.parquet.read_table(file, columns=self.columns).to_pylist()
                    return rows
        except PermissionError:
            raise
        except (self.arrow.ArrowInvalid, OSError) as torn:
            warnings.warn(f"{path}: dropped, for it cannot be read: {torn}", stacklevel=4)
            path.unlink()
            return []
        raise Error(f"{path}: columns {schema.names}, but those of a sweep are {self.schema.names}: choose another folder")

    def _write(self, kind: str, rows: list[dict[str, Any]]) -> None:
        if rows:
            path = self.folder / f"{kind}-{uuid.uuid4().hex}.parquet"
            part = path.with_name(f".{path.name}.tmp")
            self.parquet.write_table(self.arrow.Table.from_pylist(rows, schema=self.schema), part)
            part.replace(path)


def _needed(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as missing:
        raise ImportError(f"cregopt.distributed needs {module}, which is not here: pip install cregopt[ray]", name=module) from missing


def _at_least(name: str, value: int, least: int) -> None:
    if not isinstance(value, (int, np.integer)) or value < least:
        raise Error(f"{name}: {value}, but it must be an integer from {least}")


def _check_options(call: Callable[..., object], given: tuple[Any, ...], options: Mapping[str, Any], **instead: str) -> None:
    """Refuses what the call in one process does not take, before anything is sent."""
    instead = {"threads": "`cpus` says how many a worker has", "device": "`gpus` says what workers solve on", **instead}
    for name in options:
        if name in instead:
            raise Error(f"option `{name}`: {instead[name]}")
    inspect.signature(call).bind(*given, **options)


def _key(search: Mapping[str, Any]) -> str:
    def plain(value: Any) -> Any:
        return value.tolist() if hasattr(value, "tolist") else list(value)

    return hashlib.sha256(json.dumps(search, sort_keys=True, default=plain).encode()).hexdigest()


def _joined(chunks: Sequence[Evaluation]) -> Evaluation:
    """Chunks one after another."""
    motions = None if chunks[0].trajectories is None else [motion for chunk in chunks for motion in chunk.trajectories or []]
    return Evaluation(
        feasible=np.concatenate([chunk.feasible for chunk in chunks]),
        n_violated=np.concatenate([chunk.n_violated for chunk in chunks]),
        max_violation=np.concatenate([chunk.max_violation for chunk in chunks]),
        cost=np.concatenate([chunk.cost for chunk in chunks]),
        iterations=np.concatenate([chunk.iterations for chunk in chunks]),
        horizon=np.concatenate([chunk.horizon for chunk in chunks]),
        trajectories=motions,
    )
