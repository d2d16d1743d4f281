"""Searches and batch evaluations, with their options."""

from __future__ import annotations

import os
from typing import Any, Mapping, Optional, Sequence, Union

from . import _cregopt
from ._cregopt import Evaluation, Gait, Task
from ._progress import Watch, watched

#: Phase durations per foot, s: stance, swing, stance, ..., stance.
Schedule = Sequence[Sequence[float]]
Path = Union[str, "os.PathLike[str]"]


def _given(**options: Any) -> dict[str, Any]:
    """Options that are not None. The program has defaults for the others."""
    return {name: value for name, value in options.items() if value is not None}


def search(
    task: Task,
    *,
    seed: int = 1,
    first: bool = False,
    gaits: Union[str, Sequence[str], Schedule, None] = None,
    population: Optional[int] = None,
    generations: Optional[int] = None,
    seconds: Optional[float] = None,
    objective: Optional[str] = None,
    alternatives: Optional[int] = None,
    refine: bool = False,
    smooth: bool = False,
    preset: Optional[str] = None,
    transcription: Optional[str] = None,
    precision: Optional[str] = None,
    device: str = "auto",
    threads: int = 0,
    settings: Optional[Mapping[str, Any]] = None,
    progress: Watch = None,
) -> Gait:
    """Searches for the gait with the lowest cost for a task.

    The same seed gives the same gait with any number of threads, and the same gait as ``cregopt solve``. Other Python threads run during the
    call. Ctrl-C ends it with ``KeyboardInterrupt``.

    Parameters
    ----------
    task : Task
        Robot, terrain, start, goal and waypoints. Each stage between waypoints is searched in turn.
    seed : int, default 1
        Seed of all random numbers.
    first : bool, default False
        Stop at the first feasible gait.
    gaits : str, list of str, or list of lists of float, optional
        Gaits to search: ``all`` families that the robot can have, some families (``"trot,walk"`` or a list), ``free`` for arbitrary schedules, a
        JSON file with ``durations``, or a schedule whose neighbourhood is searched. Default: ``all``, or the preset's.
    population : int, optional
        Candidates per generation. Default: 16, or the preset's.
    generations : int, optional
        Largest number of generations after that of the families' typical gaits. Default: 3, or the preset's.
    seconds : float, optional
        Time limit of the search, s, after which the best gait so far is returned. It applies to each stage separately; ``refine`` takes extra
        time. With a limit the gait depends on the speed of the machine.
    objective : str, optional
        Objective that ranks gaits: ``transport`` (default), ``time``, ``effort`` or one of the paper's.
    alternatives : int, optional
        Number of gaits to return: the best, and the best of other families. Default: 1.
    refine : bool, default False
        Bring the gait to a local optimum of its cost, with the phase durations among the variables.
    smooth : bool, default False
        Reduce a cost of forces and base motion after each solve.
    preset : str, optional
        Name of one of the paper's searches.
    transcription : str, optional
        Constraints that a motion must satisfy: ``momentum`` (default) or ``towr``.
    precision : str, optional
        Floating-point type of the solver: ``f32`` (default) or ``f64``.
    device : str, default "auto"
        ``cpu``, ``gpu``, ``gpu:NAME``, or ``auto``, which uses a GPU for large batches.
    threads : int, default 0
        Number of threads; 0 uses one per processor. Results do not depend on it.
    settings : dict, optional
        Any setting, in the tables ``search``, ``transcription``, ``solver`` and ``refine``, as in the ``scenario.toml`` of a saved gait. Example:
        ``{"solver": {"max_iterations": 100}}``.
    progress : bool or callable, optional
        True shows a progress bar by tqdm (``pip install cregopt[progress]``). A callable is called on the calling thread with a dictionary per
        generation, per improvement, and per level of a search on lower ground: ``event`` is ``generation``, ``improvement`` or
        ``lower-ground``, the other keys are those of ``generations``, ``improvements`` and ``lower_ground`` in ``gait.to_dict()``. An
        exception that it raises ends the search and is raised again.

    Returns
    -------
    Gait
        The best gait. If no gait is feasible, the candidate with the smallest violation: ``feasible`` is False, and ``diagnosis`` gives the reason.
        For a task with waypoints, the gait of the last stage, or of the first stage without a feasible gait; ``stages`` has the gaits of all stages.

    Raises
    ------
    Error
        If an option is invalid, the task is certainly impossible, or the device does not exist.
    """
    options = scenario_options(
        seed=seed,
        first=first,
        gaits=gaits,
        population=population,
        generations=generations,
        seconds=seconds,
        objective=objective,
        alternatives=alternatives,
        refine=refine,
        smooth=smooth,
        preset=preset,
        transcription=transcription,
        precision=precision,
        device=device,
        threads=threads,
        settings=settings,
    )
    with watched(progress) as callback:
        return _cregopt.search(task, options, callback)


def scenario_options(
    *,
    gaits: Union[str, Sequence[str], Schedule, None] = None,
    seconds: Optional[float] = None,
    settings: Optional[Mapping[str, Any]] = None,
    **options: Any,
) -> dict[str, Any]:
    """Options of :func:`search` under the keys of a scenario file."""
    tables = dict(settings or {})
    gait: Optional[str] = None
    if gaits is None or isinstance(gaits, str):
        gait = gaits
    elif all(isinstance(family, str) for family in gaits):
        gait = ",".join(str(family) for family in gaits)
    else:
        tables["search"] = {**tables.get("search", {}), "gaits": {"around": gaits}}
    return _given(gait=gait, time=seconds, settings=tables, **options)


def evaluate(
    task: Task,
    schedules: Sequence[Schedule],
    *,
    trajectories: bool = False,
    smooth: bool = False,
    transcription: Optional[str] = None,
    precision: Optional[str] = None,
    device: str = "auto",
    threads: int = 0,
    settings: Optional[Mapping[str, Any]] = None,
) -> Evaluation:
    """Solves and certifies the given schedules as one batch.

    Other Python threads run during the call. Ctrl-C ends it with ``KeyboardInterrupt``.

    Parameters
    ----------
    task : Task
        Task without waypoints. If its goal has a time, the schedules are scaled to it.
    schedules : list of schedules
        One schedule per candidate. A schedule has one list per foot of phase durations, s: stance, swing, stance, ..., stance.
    trajectories : bool, default False
        Also return the motions.
    smooth, transcription, precision, device, threads, settings
        See :func:`search`. Of ``settings["search"]`` only the weights ``cost`` are used.

    Returns
    -------
    Evaluation
        Arrays of shape (n,), in the order of the schedules.

    Raises
    ------
    Error
        If a schedule does not fit the robot (the message has its index), the task has waypoints, an option is invalid, or the device does not exist.
    """
    options = _given(
        smooth=smooth,
        transcription=transcription,
        precision=precision,
        device=device,
        threads=threads,
        settings=dict(settings or {}),
    )
    return _cregopt.evaluate(task, schedules, options, trajectories)


def solve(path: Path, *, out: Optional[Path] = None, progress: Watch = None) -> list[Gait]:
    """Runs the search that a scenario file describes, like ``cregopt solve FILE``.

    Parameters
    ----------
    path : path
        Scenario file (.toml).
    out : path, optional
        Folder for result.json, trajectory.json and scenario.toml, instead of the file's ``out``.
    progress : bool or callable, optional
        See :func:`search`.

    Returns
    -------
    list of Gait
        One gait per stage between waypoints, up to the first stage without a feasible gait. Without waypoints there is one stage.

    Raises
    ------
    Error
        If the file is invalid.
    OSError
        If a file cannot be read or written.
    """
    with watched(progress) as callback:
        return _cregopt.solve(path, out, callback)
