"""Workers of a Ray cluster, and what dies of them."""

from __future__ import annotations

import importlib
import itertools
import warnings
from typing import Any, Callable, Iterable, Iterator, Optional, Sequence

import numpy as np

from ._cregopt import Error, __version__
from ._search import Schedule

#: Candidates of a chunk at most, without GPUs and with: what is solved again when a worker dies. A GPU is not faster with more.
_LARGEST_CHUNK = (256, 8192)
#: Chunks for each worker: the last ones to end keep the others waiting for a part of a chunk's time. A GPU is opened for each.
_CHUNKS_A_WORKER = (4, 1)


class Cluster:
    """Workers of a number of CPUs and GPUs on the cluster that this process has joined."""

    def __init__(self, cpus: int, gpus: float, max_retries: int) -> None:
        at_least("cpus", cpus, 1)
        at_least("max_retries", max_retries, 0)
        if not isinstance(gpus, (int, float)) or not (0 <= gpus < 1 or gpus == 1):
            raise Error(f"gpus: {gpus}, but it must be a number from 0 to 1: a worker solves on one GPU at most")
        self.ray = needed("ray")
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
            at_least("chunk", asked, 1)
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


def needed(module: str) -> Any:
    """A module that is installed only where clusters are."""
    try:
        return importlib.import_module(module)
    except ImportError as missing:
        raise ImportError(f"cregopt.distributed needs {module}, which is not here: pip install cregopt[ray]", name=module) from missing


def at_least(name: str, value: int, least: int) -> None:
    """Refuses what is no integer from the least on."""
    if not isinstance(value, (int, np.integer)) or value < least:
        raise Error(f"{name}: {value}, but it must be an integer from {least}")
