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

__all__ = ["evaluate", "search", "sweep"]

#: How long a search waits before it asks whether it is to go on, s.
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
    progress: Watch = None,
    **options: Any,
) -> Gait:
    """Searches for the cheapest gait of a task, as :func:`cregopt.search` does, with each generation solved on a cluster.

    This process draws the schedules, prices what comes back and certifies the best of it, on all of its cores: each keeps up with some three
    workers' cores. ``refine`` runs here, too. Other threads of Python go on meanwhile; Ctrl-C ends it with ``KeyboardInterrupt``, and what the workers
    are at with it.

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
    progress : bool or callable, optional
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
    cluster = Cluster(cpus, gpus, max_retries)
    if chunk is not None:
        at_least("chunk", chunk, 1)

    def solve(task: Task, told: str, schedules: Sequence[Schedule]) -> Iterator[Optional[tuple[int, Any]]]:
        shared = (task, told, cluster.device, cpus)
        for first, outcome in cluster.chunks(_solve_chunk, shared, schedules, cluster.chunk(chunk, len(schedules)), patience=_PATIENCE):
            if isinstance(outcome, str):
                raise Error(outcome)
            yield None if first is None else (first, outcome)

    name = f"{cluster.device}, Ray's workers of {cpus} threads"
    with watched(progress) as tell:
        return _cregopt.search(task, _search.asked(seed=seed, **options), tell, (cluster.device, name, solve))


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
    progress : bool or callable, optional
        True shows a bar of searches by tqdm (``pip install cregopt[progress]``). A callable is called with each new row, a dictionary. An exception
        in it ends the sweep and is raised; what was found is kept.
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
        Without a cluster, and where workers cannot run at all. A search that fails makes a row with its ``error``.
    TypeError
        For options that no search has.
    """
    _check_options(_search.search, (None,), options, seed="`seeds` is for that")
    cluster = Cluster(cpus, gpus, max_retries)
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
    store = Store(pathlib.Path(folder))
    rows = store.open(jobs)
    work = cluster.remote(_search_row)
    shared = cluster.ray.put((__version__, {**given, "device": cluster.device, "threads": cpus}, trajectories))
    missing = [key for key in jobs if key not in rows]
    with contextlib.ExitStack() as ending:
        tell = progress if callable(progress) else None
        if progress is True:
            shown = ending.enter_context(bar("sweep", " searches", len(jobs)))
            shown.update(len(rows))
            tell = lambda row: shown.update()
        ending.callback(store.flush)
        for key, outcome in cluster.each(lambda key: work.remote(shared, jobs[key].task, jobs[key].seed), missing):
            if isinstance(outcome, cluster.ray.exceptions.RayTaskError):
                raise Error(f"task {jobs[key].name}, seed {jobs[key].seed}: {cluster.why(outcome)}") from outcome
            result = {"error": cluster.why(outcome)} if isinstance(outcome, Exception) else outcome
            row = {**store.blank, "key": key, "task": jobs[key].name, "seed": jobs[key].seed, **result}
            store.add(row)
            rows[key] = {name: value for name, value in row.items() if name != "trajectory"}
            if tell is not None:
                tell(row)
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


def _solve_chunk(shared: tuple[str, Task, str, str, int], first: int, schedules: Sequence[Schedule]) -> Union[tuple[list[Any], Any], str]:
    """A chunk of a search's schedules, of which the first has this index: solved, and not yet certified."""
    version, task, told, device, threads = shared
    _same_version(version)
    try:
        return _cregopt.solve_chunk(task, told, schedules, device, threads)
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
