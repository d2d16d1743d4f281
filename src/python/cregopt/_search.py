"""Searches and batches, with their options."""

from __future__ import annotations

import os
from typing import Any, Mapping, Optional, Sequence, Union

from . import _cregopt
from ._cregopt import Evaluation, Gait, Task
from ._progress import Watch, watched

#: Stance, swing, stance, ... of each foot, s.
Schedule = Sequence[Sequence[float]]
Path = Union[str, "os.PathLike[str]"]


def _given(**options: Any) -> dict[str, Any]:
    """Those options that are not left to the program."""
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
    """Searches for the cheapest gait of a task.

    The same seed gives the same gait at any number of threads, and the one that ``cregopt solve`` gives. Other threads of Python go on
    meanwhile; Ctrl-C ends it with ``KeyboardInterrupt``.

    Parameters
    ----------
    task : Task
    seed : int, default 1
        Seed of all random numbers.
    first : bool, default False
        End with the first gait.
    gaits : str, list of str, or list of lists of float, optional
        Which gaits: ``all`` families that the robot can have, some of them (``"trot,walk"`` or a list), ``free`` for any schedule at all, a JSON
        file with ``durations``, or a schedule, near which is looked. ``all`` unless a preset says otherwise.
    population : int, optional
        Candidates a generation; 16 unless a preset says otherwise.
    generations : int, optional
        Most generations behind the families' typical gaits; 3 unless a preset says otherwise.
    seconds : float, optional
        End the search after this time with the best so far, s; each leg has it anew, and ``refine`` comes on top. Gaits then depend on the machine.
    objective : str, optional
        What is best: ``transport`` (default), ``time``, ``effort`` or one of the paper's.
    alternatives : int, optional
        Gaits to return: the best, and the best of other families. Default 1.
    refine : bool, default False
        Bring the gait to a local optimum of its cost, phase durations among the variables.
    smooth : bool, default False
        Lower a cost of forces and of base motion after each solve.
    preset : str, optional
        The paper's search, by name.
    transcription : str, optional
        Rows that a motion must satisfy: ``momentum`` (default) or ``towr``.
    precision : str, optional
        Scalar of the solver: ``f32`` (default) or ``f64``.
    device : str, default "auto"
        ``cpu``, ``gpu``, ``gpu:NAME``, or ``auto``: a GPU for large batches.
    threads : int, default 0
        Threads; 0 is one a processor. Results do not depend on it.
    settings : dict, optional
        Any setting, in the tables ``search``, ``transcription``, ``solver`` and ``refine``, as in the ``scenario.toml`` of a saved gait: for example
        ``{"solver": {"max_iterations": 100}}``.
    progress : bool or callable, optional
        True shows a bar by tqdm (``pip install cregopt[progress]``). A callable is called with a dictionary for each generation and each better
        gait, on this thread: ``event`` is ``generation`` or ``improvement``, the other keys are those of ``generations`` and ``improvements`` in
        ``gait.to_dict()``. An exception in it ends the search and is raised.

    Returns
    -------
    Gait
        Without a gait the candidate that violates least: ``feasible`` is False, and ``diagnosis`` says why. Of a task with places on the way the
        gait of the last leg, or of the first that has none; its ``legs`` are all of them.

    Raises
    ------
    Error
        For options or a task that cannot be, and for a device that is not there.
    """
    options = asked(
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
    with watched(progress) as tell:
        return _cregopt.search(task, options, tell)


def asked(
    *,
    gaits: Union[str, Sequence[str], Schedule, None] = None,
    seconds: Optional[float] = None,
    settings: Optional[Mapping[str, Any]] = None,
    **options: Any,
) -> dict[str, Any]:
    """Options of :func:`search` by the keys of a scenario file."""
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
    """Solves and certifies given schedules as one batch.

    Other threads of Python go on meanwhile; Ctrl-C ends it with ``KeyboardInterrupt``.

    Parameters
    ----------
    task : Task
        Without places on the way.
    schedules : list of schedules
        Each a list of phase durations for each foot, s: stance, swing, stance, ...
    trajectories : bool, default False
        Whether motions are returned, too.
    smooth, transcription, precision, device, threads, settings
        As :func:`search` has them. Of ``settings["search"]`` the weights ``cost`` count.

    Returns
    -------
    Evaluation
        Arrays in the order of the schedules.

    Raises
    ------
    Error
        For a schedule that does not fit the robot, and as :func:`search`.
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
    """Searches as a scenario file asks, as ``cregopt solve FILE`` does.

    Parameters
    ----------
    path : path
        Scenario file (.toml).
    out : path, optional
        Folder for result.json, trajectory.json and scenario.toml, instead of the file's ``out``.
    progress : bool or callable, optional
        As :func:`search` has it.

    Returns
    -------
    list of Gait
        One for each leg of the way, to the first that has no gait; without waypoints one.
    """
    with watched(progress) as tell:
        return _cregopt.solve(path, out, tell)
