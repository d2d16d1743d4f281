"""Searches, evaluations, sweeps and data sets on many machines with Ray: ``pip install cregopt[ray]``.

>>> import ray
>>> from cregopt import distributed
>>> ray.init(address="auto")  # joins a cluster; ``ray.init()`` starts one on this machine
>>> gait = distributed.search(task, seed=1, population=256)
>>> found = distributed.evaluate(task, schedules)
>>> table = distributed.sweep(tasks, "sweep", seeds=range(1, 6))
>>> manifest = distributed.dataset("dataset.toml", "data")

Every node needs the same version of this package. Results on CPUs depend neither on the number of workers nor on the division of the work, if all
processors have the same vector instructions. When a process or node dies, another worker repeats its work.

:func:`search` divides each generation among the workers. Generations run one after another, so that workers wait at the end of each. They wait least
if a generation has as many candidates as there are workers, or a few times as many. The searches of a :func:`sweep` do not wait for one another.

With ``gpus`` workers solve on GPUs, like ``device="gpu"`` in one process. Results then depend on the adapter and its driver, and equal those of one
process only with the same adapter and driver. Ray counts GPUs, but does not select one for Vulkan: on a node with several GPUs all workers use the
same GPU.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import json
import pathlib
import re
from typing import Any, Callable, Iterable, Iterator, Mapping, NamedTuple, Optional, Sequence, Union

import numpy as np

from . import _cregopt, _search
from ._cluster import Cluster, at_least
from ._cregopt import Error, Evaluation, Gait, Task, __version__
from ._pickle import parts
from ._progress import Watch, bar, watched
from ._search import Path, Schedule
from ._store import Store

__all__ = ["dataset", "evaluate", "search", "sweep"]

#: Longest time that a call waits for workers before it checks whether it has been interrupted, s.
_PATIENCE = 0.05


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
    """Solves and certifies the given schedules on a cluster, like :func:`cregopt.evaluate` in one process.

    Parameters
    ----------
    task, schedules
        See :func:`cregopt.evaluate`.
    chunk : int, optional
        Number of schedules that a worker gets at once. Default: a quarter of its share, at most 256; with GPUs its whole share, at most 8192.
        Results do not depend on it.
    cpus : int, default 1
        CPUs per worker, requested from Ray, and number of its threads. On many nodes a larger number is faster, because there are fewer chunks to
        hand out, at 0.7 ms each.
    gpus : float, default 0
        GPUs per worker, requested from Ray: 1, or a fraction of 1 if workers share a GPU. With any value but 0 a worker solves on a GPU.
    max_retries : int, default 3
        Number of times that a chunk is given to another worker after a process or node died.
    trajectories : bool, default False
        Also return the motions, about 70 kB each on the network.
    **options
        ``smooth``, ``transcription``, ``precision`` and ``settings`` of :func:`cregopt.evaluate`.

    Returns
    -------
    Evaluation
        Arrays of shape (n,), in the order of the schedules. On CPUs they equal those of :func:`cregopt.evaluate` with ``device="cpu"`` bit for bit.

    Raises
    ------
    ImportError
        If Ray is not installed.
    Error
        If there is no cluster, if :func:`cregopt.evaluate` rejects an argument (of several invalid schedules the first is reported), or if the
        workers of a chunk died ``max_retries + 1`` times.
    """
    _check_options(_search.evaluate, (task, schedules), options)
    cluster = Cluster(cpus, gpus, max_retries)
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
        # Chunks after the first invalid one need not be solved.
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
    progress: Watch = None,
    **options: Any,
) -> Gait:
    """Searches for the gait with the lowest cost for a task, like :func:`cregopt.search`, and solves each generation on a cluster.

    This process samples the schedules, computes the costs of the solutions and certifies the best ones, on all of its cores. Each of its cores keeps
    up with about three cores of workers. ``refine`` also runs in this process. Other Python threads run during the call. Ctrl-C ends it with
    ``KeyboardInterrupt`` and cancels the work of the workers.

    Parameters
    ----------
    task : Task
        Task, with or without waypoints. Each stage between waypoints is searched in turn.
    seed : int, default 1
        Seed of all random numbers.
    chunk : int, optional
        Number of schedules that a worker gets at once. Default: a quarter of its share, at most 256; with GPUs its whole share, at most 8192.
        Results do not depend on it.
    cpus : int, default 1
        CPUs per worker, requested from Ray, and number of its threads.
    gpus : float, default 0
        GPUs per worker, requested from Ray: 1, or a fraction of 1 if workers share a GPU. With any value but 0 a worker solves on a GPU.
    max_retries : int, default 3
        Number of times that a chunk is given to another worker after a process or node died.
    progress : bool or callable, optional
        See :func:`cregopt.search`.
    **options
        Other options of :func:`cregopt.search`, except ``threads`` and ``device``. A ``population`` of a few candidates per worker keeps a cluster
        busy; the default of 16 is enough for four workers.

    Returns
    -------
    Gait
        On CPUs bit for bit the gait of :func:`cregopt.search` with ``device="cpu"``, except for times and the name of the device in ``to_dict()``.

    Raises
    ------
    ImportError
        If Ray is not installed.
    Error
        If there is no cluster, if :func:`cregopt.search` rejects an argument, or if the workers of a chunk died ``max_retries + 1`` times.
    """
    _check_options(_search.search, (task,), options)
    cluster = Cluster(cpus, gpus, max_retries)
    if chunk is not None:
        at_least("chunk", chunk, 1)

    def solve(task: Task, job: str, schedules: Sequence[Schedule]) -> Iterator[Optional[tuple[int, Any]]]:
        shared = (task, job, cluster.device, cpus)
        for first, outcome in cluster.chunks(_solve_chunk, shared, schedules, cluster.chunk(chunk, len(schedules)), patience=_PATIENCE):
            if isinstance(outcome, str):
                raise Error(outcome)
            yield None if first is None else (first, outcome)

    name = f"{cluster.device}, Ray's workers of {cpus} threads"
    with watched(progress) as callback:
        return _cregopt.search(task, _search.scenario_options(seed=seed, **options), callback, (cluster.device, name, solve))


def sweep(
    tasks: Union[Sequence[Task], Mapping[str, Task]],
    folder: Path,
    *,
    seeds: Iterable[int] = (1,),
    cpus: int = 1,
    gpus: float = 0,
    max_retries: int = 3,
    trajectories: bool = False,
    progress: Watch = None,
    **options: Any,
) -> Any:
    """Searches for the gaits of many tasks on a cluster, and stores the results in a folder of Parquet files.

    A search whose result is in the folder is not run again: an interrupted sweep continues, and a sweep with more tasks or seeds runs only the new
    searches. A search is identified by task, name, seed, options and version. Each file is written as a whole, after 10 s or 256 rows; a file that
    cannot be read is deleted with a warning. Only one sweep at a time may use a folder.

    Parameters
    ----------
    tasks : list of Task, or dict of str to Task
        Tasks, or tasks by name. In a list the names are ``0``, ``1``, ...
    folder : path
        Folder of the rows, created if missing. ``pyarrow.parquet.read_table(folder)`` reads all rows, in the order in which searches ended.
    seeds : list of int, default (1,)
        Seeds. Each task is searched with each seed.
    cpus : int, default 1
        CPUs per worker, requested from Ray, and number of its threads.
    gpus : float, default 0
        GPUs per worker, requested from Ray: 1, or a fraction of 1 if workers share a GPU. With any value but 0 a worker solves on a GPU.
    max_retries : int, default 3
        Number of times that a search is started again after its process or node died.
    trajectories : bool, default False
        Also store the motions, in the column ``trajectory``: the text of trajectory.json, about 50 kB each.
    progress : bool or callable, optional
        True shows a progress bar of searches by tqdm (``pip install cregopt[progress]``). A callable is called with each new row, a dictionary. An
        exception that it raises ends the sweep and is raised again; results found until then are stored.
    **options
        Options of :func:`cregopt.search`, except ``seed``, ``threads``, ``device`` and ``progress``. With ``seconds`` rows depend on the machine.

    Returns
    -------
    pyarrow.Table
        One row per task and seed, in their order. Except for ``seconds`` it does not depend on the number of workers. Columns:

        ===============  =======  ==============================================================================================================
        ``key``          string   identifies the search
        ``task``         string   name of the task
        ``seed``         int64
        ``feasible``     bool     True if the certificate holds; otherwise the row has the candidate with the smallest violation
        ``family``       string   family of the gait; null if it belongs to no family
        ``cost``         float64  cost per weight and distance; null if the gait is not feasible
        ``objective``    string   objective that ranks gaits
        ``horizon``      float64  duration of the motion, s
        ``seconds``      float64  duration of the search, all stages together, s
        ``durations``    string   schedule in JSON: phase durations per foot, s: stance, swing, stance, ..., stance
        ``error``        string   reason for a missing result, otherwise null; the next sweep runs such a search again
        ===============  =======  ==============================================================================================================

        The files also have the column ``trajectory``. For a task with waypoints the row describes the gait that :func:`cregopt.search` returns, which
        is that of the last stage.

    Raises
    ------
    ImportError
        If Ray or pyarrow is not installed.
    Error
        If there is no cluster, or if workers cannot run at all. A search that fails yields a row with its ``error`` instead.
    TypeError
        If a search has no such option.
    """
    _check_options(_search.search, (None,), options, seed="use `seeds`")
    cluster = Cluster(cpus, gpus, max_retries)
    named = tasks.items() if isinstance(tasks, Mapping) else ((str(number), task) for number, task in enumerate(tasks))
    given = {name: value for name, value in options.items() if value is not None}
    common = {"version": __version__, "options": given, "trajectories": trajectories}
    if gpus:
        common["device"] = cluster.device
    jobs: dict[str, _Job] = {}
    every_seed = [int(seed) for seed in seeds]
    for name, task in named:
        identity = {**common, "task": parts(task), "name": name}
        jobs.update((_key({**identity, "seed": seed}), _Job(name, seed, task)) for seed in every_seed)
    store = Store(pathlib.Path(folder))
    rows = store.open(jobs)
    work = cluster.remote(_search_row)
    shared = cluster.ray.put((__version__, {**given, "device": cluster.device, "threads": cpus}, trajectories))
    missing = [key for key in jobs if key not in rows]
    with contextlib.ExitStack() as ending:
        callback = progress if callable(progress) else None
        if progress is True:
            shown = ending.enter_context(bar("sweep", " searches", len(jobs)))
            shown.update(len(rows))
            callback = lambda row: shown.update()
        ending.callback(store.flush)
        for key, outcome in cluster.each(lambda key: work.remote(shared, jobs[key].task, jobs[key].seed), missing):
            if isinstance(outcome, cluster.ray.exceptions.RayTaskError):
                raise Error(f"task {jobs[key].name}, seed {jobs[key].seed}: {cluster.why(outcome)}") from outcome
            result = {"error": cluster.why(outcome)} if isinstance(outcome, Exception) else outcome
            row = {**store.blank, "key": key, "task": jobs[key].name, "seed": jobs[key].seed, **result}
            store.add(row)
            rows[key] = {name: value for name, value in row.items() if name != "trajectory"}
            if callback is not None:
                callback(row)
    return store.table([rows[key] for key in jobs])


def dataset(
    spec: Path,
    folder: Path,
    *,
    cpus: int = 1,
    gpus: float = 0,
    max_retries: int = 3,
    progress: Union[bool, Callable[[int, int], object], None] = None,
) -> dict[str, Any]:
    """Makes a data set of certified motions on a cluster, as ``cregopt dataset`` does in one process.

    Each worker makes whole shards: it draws, solves and certifies. This process certifies and samples each motion again, drops duplicates, and writes
    the files. Each of its cores keeps up with about nine cores of workers. The same call continues an interrupted run.

    Parameters
    ----------
    spec : path
        Specification (.toml). Only this process reads it and the files in it.
    folder : path
        Folder of the data set, created if missing.
    cpus : int, default 1
        CPUs per worker, requested from Ray, and number of its threads.
    gpus : float, default 0
        GPUs per worker, requested from Ray: 1, or a fraction of 1 if workers share a GPU. With any value but 0 a worker solves on a GPU.
    max_retries : int, default 3
        Number of times that a shard is given to another worker after a process or node died.
    progress : bool or callable, optional
        True shows a progress bar by tqdm (``pip install cregopt[progress]``). A callable is called after each shard, with the number of motions so
        far and that of all motions. An exception that it raises ends the run and is raised again.

    Returns
    -------
    dict
        Content of ``dataset.json``. On CPUs all files equal those of ``cregopt dataset --device cpu`` byte for byte.

    Raises
    ------
    ImportError
        If Ray is not installed.
    Error
        If there is no cluster, if ``spec`` or ``folder`` is invalid, or if the workers of a shard died ``max_retries + 1`` times.
    """
    cluster = Cluster(cpus, gpus, max_retries)
    plan = _cregopt.dataset_plan(spec, cluster.device)
    work, shared = cluster.remote(_dataset_drafts), cluster.ray.put((__version__, plan, cluster.device, cpus))
    pending: dict[tuple[int, int], Any] = {}

    def drafts(following: list[tuple[int, int]]) -> Optional[str]:
        for shard in following[: cluster.ahead()]:
            if shard not in pending:
                pending[shard] = work.remote(shared, shard)
        robot, number = first = following[0]
        ready, _ = cluster.ray.wait([pending[first]], timeout=_PATIENCE)
        if not ready:
            return None
        try:
            text: str = cluster.ray.get(pending.pop(first))
        except cluster.ray.exceptions.RayError as error:
            raise Error(f"robot {robot}, shard {number}: {cluster.why(error)}") from error
        return text

    with contextlib.ExitStack() as ending:
        ending.callback(lambda: [cluster.ray.cancel(reference) for reference in pending.values()])
        report = progress if callable(progress) else lambda done, asked: None
        if progress is True:
            shown = ending.enter_context(bar("data set", " motions"))

            def report(done: int, asked: int) -> None:
                shown.total = asked
                shown.update(done - shown.n)

        manifest: dict[str, Any] = json.loads(_cregopt.dataset_make(plan, folder, cluster.device, drafts, report))
    return manifest


class _Job(NamedTuple):
    """One search of a sweep."""

    name: str
    seed: int
    task: Task


# Functions that workers run. They return errors as values, so that a sweep continues, and the error of the first schedule can be selected.


def _same_version(version: str) -> None:
    if version != __version__:
        raise RuntimeError(f"cregopt {__version__} on a worker, but {version} in the calling process: install the same version on every node")


def _evaluate_chunk(shared: tuple[str, Task, dict[str, Any]], first: int, schedules: Sequence[Schedule]) -> Union[Evaluation, str]:
    """Evaluation of a chunk of schedules, or an error message. ``first``: index of its first schedule."""
    version, task, options = shared
    _same_version(version)
    try:
        return _search.evaluate(task, schedules, **options)
    except Error as error:
        return re.sub(r"^schedules\[(\d+)\]", lambda found: f"schedules[{first + int(found[1])}]", str(error))


def _solve_chunk(shared: tuple[str, Task, str, str, int], first: int, schedules: Sequence[Schedule]) -> Union[tuple[list[Any], Any], str]:
    """Solutions of a chunk of a search's schedules, not yet certified, or an error message. ``first``: index of its first schedule."""
    version, task, job, device, threads = shared
    _same_version(version)
    try:
        return _cregopt.solve_chunk(task, job, schedules, device, threads)
    except Error as error:
        return str(error)


def _dataset_drafts(shared: tuple[str, str, str, int], shard: tuple[int, int]) -> str:
    """Motions of a shard of a data set, as JSON."""
    version, plan, device, threads = shared
    _same_version(version)
    return _cregopt.dataset_drafts(plan, shard, device, threads)


def _search_row(shared: tuple[str, dict[str, Any], bool], task: Task, seed: int) -> dict[str, Any]:
    """Columns of a row that describe the result of its search."""
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
            "seconds": sum(stage.seconds for stage in gait.stages),
            "durations": json.dumps(gait.schedule),
            "trajectory": gait.trajectory.to_json() if trajectories else None,
        }
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a panic of the compiled module is not an Exception
        return {"error": f"{type(error).__name__}: {error}"}


def _check_options(call: Callable[..., object], given: tuple[Any, ...], options: Mapping[str, Any], **instead: str) -> None:
    """Raises an error for options that ``call`` does not accept, before any work is sent. ``instead``: options with the advice to give."""
    instead = {"threads": "use `cpus`, the threads per worker", "device": "use `gpus`", **instead}
    for name in options:
        if name in instead:
            raise Error(f"option `{name}`: {instead[name]}")
    inspect.signature(call).bind(*given, **options)


def _key(search: Mapping[str, Any]) -> str:
    """Hash that identifies a search."""

    def plain(value: Any) -> Any:
        return value.tolist() if hasattr(value, "tolist") else list(value)

    return hashlib.sha256(json.dumps(search, sort_keys=True, default=plain).encode()).hexdigest()


def _joined(chunks: Sequence[Evaluation]) -> Evaluation:
    """Concatenates the evaluations of chunks."""
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
