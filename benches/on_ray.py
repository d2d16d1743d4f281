"""Candidates per second on the workers of a local cluster and on threads of one process, bytes per candidate, and the time of a search.

    python benches/on_ray.py --candidates 192 --rounds 3 --workers 1,2,4

Needs Linux and the package with its extra (pip install '.[ray]'). Each worker has one CPU, and Ray is started with as many CPUs as workers. The cases
alternate in rounds and medians are reported, because machines are shared. If other processes use the cores, CPU times are more reliable than wall
times; they include those of Ray's processes.
"""

import argparse
import os
import pathlib
import pickle
import statistics
import time
from typing import Any, Callable

import cregopt
import ray
from cregopt import distributed
from population import population


def cpu() -> float:
    """CPU time that this process and those of Ray have used, s."""
    used = time.process_time()
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            command = (process / "cmdline").read_text()
            if "ray::" in command or "raylet" in command or "gcs_server" in command:
                user, system = (process / "stat").read_text().rpartition(")")[2].split()[11:13]
                used += (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
        except OSError:
            continue
    return used


def seconds(call: Callable[[], object]) -> tuple[float, float]:
    """Wall time and CPU time of a call, s."""
    begun, before = time.perf_counter(), cpu()
    call()
    return time.perf_counter() - begun, cpu() - before


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--candidates", type=int, default=192)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--workers", default="1,2,4")
    parser.add_argument("--chunk", type=int)
    options = parser.parse_args()
    task = cregopt.Task.from_scenario("s1", target=10)
    schedules = population(task, options.candidates)
    n = len(schedules)
    times: dict[str, list[tuple[float, float]]] = {}

    def note(name: str, spent: tuple[float, float]) -> None:
        times.setdefault(name, []).append(spent)

    wide: dict[str, Any] = {"population": 64, "generations": 2}

    for _ in range(options.rounds):
        for threads in (1, 2, 4):
            note(f"one process, threads {threads}", seconds(lambda: cregopt.evaluate(task, schedules, device="cpu", threads=threads)))
            note(f"search, threads {threads}", seconds(lambda: cregopt.search(task, device="cpu", threads=threads, **wide)))
        for workers in map(int, options.workers.split(",")):
            ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False)
            distributed.evaluate(task, schedules[: 4 * workers], chunk=1)  # starts the processes
            note(f"Ray, workers {workers}", seconds(lambda: distributed.evaluate(task, schedules, chunk=options.chunk)))
            distributed.search(task, first=True)  # starts those of searches
            note(f"search, Ray, workers {workers}", seconds(lambda: distributed.search(task, chunk=options.chunk, **wide)))
            if workers == 1:
                nothing: Any = ray.remote(num_cpus=1)(lambda: None)
                note("300 tasks of Ray that do nothing", seconds(lambda: ray.get([nothing.remote() for _ in range(300)])))
            ray.shutdown()
    print("| | s | CPU, s | candidates per second | per CPU second |\n|---|---|---|---|---|")
    for name, spent in times.items():
        clock, used = (statistics.median(column) for column in zip(*spent))
        rates = "| |" if "nothing" in name or "search" in name else f"| {n / clock:.1f} | {n / used:.1f} |"
        print(f"| {name} | {clock:.3g} | {used:.3g} {rates}")
    found = cregopt.evaluate(task, schedules[:100], device="cpu")
    motions = cregopt.evaluate(task, schedules[:100], device="cpu", trajectories=True)
    size = {name: len(pickle.dumps(item, 5)) / 100 for name, item in (("schedule", schedules[:100]), ("result", found), ("with motion", motions))}
    print("bytes per candidate in chunks of 100: " + ", ".join(f"{name} {value:.0f}" for name, value in size.items()))
    print(f"the task: {len(pickle.dumps(task, 5))} bytes once per node")


if __name__ == "__main__":
    main()
