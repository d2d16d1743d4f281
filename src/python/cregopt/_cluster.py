"""Workers of a Ray cluster: submission of chunks, results in the order of completion, and retries after a worker died."""

from __future__ import annotations

import importlib
import itertools
import warnings
from typing import Any, Callable, Iterable, Iterator, Optional, Sequence

import numpy as np

from ._cregopt import Error, __version__
from ._search import Schedule

#: Largest number of candidates per chunk, without and with GPUs. A chunk is solved again when its worker dies. Larger chunks make a GPU no faster.
_LARGEST_CHUNK = (256, 8192)
#: Chunks per worker, without and with GPUs. With more chunks, workers wait a shorter time for the last chunk. Each chunk opens the GPU again.
_CHUNKS_PER_WORKER = (4, 1)


class Cluster:
    """Workers with a given number of CPUs and GPUs each, on the cluster that this process has joined."""

    def __init__(self, cpus: int, gpus: float, max_retries: int) -> None:
        at_least("cpus", cpus, 1)
        at_least("max_retries", max_retries, 0)
        if not isinstance(gpus, (int, float)) or not (0 <= gpus < 1 or gpus == 1):
            raise Error(f"gpus: {gpus}, but it must be a number from 0 to 1: a worker solves on one GPU at most")
        self.ray = needed("ray")
        if not self.ray.is_initialized():
            raise Error('no cluster: join one with ray.init(address="auto"), or start one on this machine with ray.init()')
        self.cpus, self.gpus, self.max_retries = cpus, gpus, max_retries
        self.device = "gpu" if gpus else "cpu"
        for name, requested in (("CPU", cpus), ("GPU", gpus)):
            largest = max((node["Resources"].get(name, 0.0) for node in self.ray.nodes() if node["Alive"]), default=0.0)
            if requested > largest:
                message = f"{name.lower()}s: {requested}, but the largest node of the cluster has {largest:.0f}: waiting for a node with more"
                warnings.warn(message, stacklevel=3)

    def workers(self) -> int:
        """Number of workers that can run at once now, at least 1."""
        resources = self.ray.cluster_resources()
        count = resources.get("CPU", 0.0) // self.cpus
        return max(1, int(min(count, resources.get("GPU", 0.0) // self.gpus) if self.gpus else count))

    def ahead(self) -> int:
        """Number of jobs that are submitted before the first of them has ended, so that workers do not wait."""
        return 2 * self.workers() + 2

    def remote(self, work: Callable[..., object]) -> Any:
        """Ray remote function that runs ``work`` with the resources and retries of this cluster's workers."""
        return self.ray.remote(num_cpus=self.cpus, num_gpus=self.gpus, max_retries=self.max_retries)(work)

    def chunk(self, requested: Optional[int], n: int) -> int:
        """Number of schedules per chunk for n schedules: the requested number, or by default a share of n."""
        if requested is not None:
            at_least("chunk", requested, 1)
            return requested
        on_gpus = self.device == "gpu"
        share = -(-n // (_CHUNKS_PER_WORKER[on_gpus] * self.workers()))
        return max(self.cpus, min(share, _LARGEST_CHUNK[on_gpus]))

    def chunks(
        self, work: Callable[..., object], shared: tuple[Any, ...], schedules: Sequence[Schedule], chunk: int, patience: Optional[float] = None
    ) -> Iterator[tuple[Any, Any]]:
        """Yields the index of the first schedule of each chunk with the result of its worker, in the order of completion.

        Workers call ``work((version, *shared), first, schedules)``. ``patience``: see :meth:`each`. Raises Error for a chunk without a result.
        """
        remote, known = self.remote(work), self.ray.put((__version__, *shared))
        firsts = range(0, len(schedules), chunk)
        for first, outcome in self.each(lambda first: remote.remote(known, first, schedules[first : first + chunk]), firsts, patience):
            if isinstance(outcome, Exception):
                last = min(first + chunk, len(schedules)) - 1
                raise Error(f"schedules[{first}] to [{last}]: {self.why(outcome)}") from outcome
            yield first, outcome

    def each(self, submit: Callable[[Any], Any], jobs: Iterable[Any], patience: Optional[float] = None) -> Iterator[tuple[Any, Any]]:
        """Yields each job once with its result, or with Ray's exception, in the order of completion.

        ``submit`` starts a job. Some jobs are submitted ahead, so that workers do not wait. After ``patience`` seconds without a result it yields
        ``(None, None)``. Jobs that are pending when the iterator is closed are cancelled.
        """
        ray, jobs = self.ray, iter(jobs)
        pending: dict[Any, Any] = {}
        try:
            while True:
                free = self.ahead() - len(pending)
                pending.update((submit(job), job) for job in itertools.islice(jobs, max(0, free)))
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
        """Message of a Ray exception, without the stack of the worker."""
        if isinstance(error, self.ray.exceptions.RayTaskError):
            return f"a worker could not run: {getattr(error, 'cause', error)}"
        lines = str(error).strip().splitlines() or [""]
        return f"no result from a worker after {self.max_retries} retries: {type(error).__name__}: {lines[0]}"


def needed(module: str) -> Any:
    """Imports an optional module; raises ImportError with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as missing:
        raise ImportError(f"cregopt.distributed needs {module}, which is not installed: pip install cregopt[ray]", name=module) from missing


def at_least(name: str, value: int, least: int) -> None:
    """Raises Error unless ``value`` is an integer of at least ``least``."""
    if not isinstance(value, (int, np.integer)) or value < least:
        raise Error(f"{name}: {value}, but it must be an integer from {least}")
