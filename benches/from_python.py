"""Overhead of solving a population from Python instead of the command line, and memory use over many calls.

    python benches/from_python.py target/release/cregopt --candidates 192 --pairs 5 --calls 1000

The program and a new Python process solve the same schedules in turn, on one thread. Times are CPU times (user and system), because machines are
shared. For Python the call, which includes reading the file as in the program, and the import are also reported separately.
"""

import argparse
import json
import os
import pathlib
import re
import resource
import statistics
import subprocess
import sys
import tempfile

import cregopt
from population import population

CHILD = """
import json, resource, sys
def cpu():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime
begun = cpu()
import cregopt, numpy
imported = cpu()
task = cregopt.Task.from_scenario("s1", target=10)
schedules = [json.loads(line)["durations"] for line in open(sys.argv[1])]
found = cregopt.evaluate(task, schedules, device="cpu", threads=1)
print(imported - begun, cpu() - imported, int(found.feasible.sum()), int(found.iterations.sum()))
"""


def cpu_of(command: list[str]) -> tuple[float, str]:
    """CPU time of a process, s, and its output."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    printed = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        sys.exit(f"{' '.join(command[:2])} failed: {process.returncode}")
    return used.ru_utime + used.ru_stime, printed


def resident() -> int:
    """Resident memory of this process, kB."""
    pages = int(pathlib.Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() // 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="cregopt, same version and build profile")
    parser.add_argument("--candidates", type=int, default=192)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--calls", type=int, default=1000)
    options = parser.parse_args()
    task = cregopt.Task.from_scenario("s1", target=10)
    schedules = population(task, options.candidates)
    rows: list[tuple[float, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder, "schedules.jsonl")
        file.write_text("".join(json.dumps({"durations": schedule, "scenario": "s1", "target": 10}) + "\n" for schedule in schedules))
        for pair in range(options.pairs):
            by_program = [options.program, "evaluate", str(file), "--threads", "1", "--device", "cpu"]
            by_python = [sys.executable, "-c", CHILD, str(file)]
            turns = [by_program, by_python] if pair % 2 == 0 else [by_python, by_program]
            spent = {command[0]: cpu_of(command) for command in turns}
            (program, output), (whole, printed) = spent[options.program], spent[sys.executable]
            imported, called, feasible, iterations = (float(word) for word in printed.split())
            found = re.match(r"(\d+) of \d+ candidates feasible, (\d+) iterations", output)
            assert found is not None and [int(word) for word in found.groups()] == [feasible, iterations], (output, printed)
            rows.append((program, called, imported, whole, called / program - 1))
            print(f"pair {pair + 1}: " + ", ".join(f"{value:.3f}" for value in rows[-1]), flush=True)
    program, called, imported, whole, more = (statistics.median(column) for column in zip(*rows))
    print("| command line, s | Python: the call | import | whole process | overhead of the call |\n|---|---|---|---|---|")
    print(f"| {program:.3f} | {called:.3f} | {imported:.3f} | {whole:.3f} | {100 * more:+.1f} % |")
    least = [min(column) for column in zip(*rows)]
    print(f"minimum of {options.pairs}: {least[0]:.3f} s and {least[1]:.3f} s, {100 * (least[1] / least[0] - 1):+.1f} %")

    short = cregopt.Task(cregopt.Robot("anymal"), cregopt.Terrain("flat"), goal=(1.0, 0.0))
    for call in range(1, options.calls + 1):
        gait = cregopt.search(short, first=True, threads=1, device="cpu")
        gait.sample().forces.sum()
        cregopt.evaluate(short, [gait.schedule], trajectories=True, threads=1, device="cpu")
        assert gait.to_dict()["feasible"] and cregopt.verify(gait).feasible
        if call in (1, options.calls // 10, options.calls // 2, options.calls):
            print(f"resident after {call} calls: {resident()} kB", flush=True)


if __name__ == "__main__":
    main()
