"""Long calls: other threads, signals, and memory over many calls."""

import resource
import signal
import subprocess
import sys
import threading
import time

import cregopt
import pytest

LONG = """
import signal
import sys
import cregopt
# Background jobs ignore the signal by default.
signal.signal(signal.SIGINT, signal.default_int_handler)
task = cregopt.Task(cregopt.Robot("anymal"), cregopt.Terrain("flat"), goal=(3.0, 0.0))
print("started", flush=True)
try:
    {call}
except KeyboardInterrupt:
    print("interrupted", flush=True)
    # The interpreter and the package still work.
    sys.exit(0 if cregopt.search(task, first=True).feasible else 1)
sys.exit(2)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends signals differently")
@pytest.mark.parametrize(
    "call",
    [
        'cregopt.search(task, population=4000, generations=1000, device="cpu")',
        'cregopt.evaluate(task, [[[0.3, 0.2] * 20 + [0.3]] * 4] * 4000, device="cpu")',
    ],
)
def test_ctrl_c_ends_a_long_call(call: str) -> None:
    process = subprocess.Popen([sys.executable, "-c", LONG.format(call=call)], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None and process.stdout.readline() == "started\n"
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        sent = time.monotonic()
        assert process.stdout.readline() == "interrupted\n"
        assert time.monotonic() - sent < 5.0
        assert process.wait(timeout=60) == 0
    finally:
        process.kill()
        process.wait()


def test_an_exception_in_the_callback_ends_the_search(task: cregopt.Task) -> None:
    records = []

    def stop(record: dict[str, object]) -> None:
        records.append(record)
        raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        cregopt.search(task, population=64, generations=1000, progress=stop)
    assert len(records) == 1


def test_other_threads_run_during_a_search(task: cregopt.Task) -> None:
    alone = cregopt.search(task, population=8, generations=2, threads=1, device="cpu").trajectory
    found: list[cregopt.Trajectory] = []

    def work() -> None:
        found.append(cregopt.search(task, population=8, generations=2, threads=1, device="cpu").trajectory)

    workers = [threading.Thread(target=work) for _ in range(4)]
    for worker in workers:
        worker.start()
    turns = 0
    while any(worker.is_alive() for worker in workers):
        turns += 1
        time.sleep(0.001)
    # If the calls held the lock of the interpreter, there would be one turn per call.
    assert turns > 50
    assert len(found) == 4 and all(trajectory == alone for trajectory in found)


def test_memory_stays_flat_over_many_calls(task: cregopt.Task) -> None:
    def call() -> int:
        gait = cregopt.search(task, first=True, threads=1, device="cpu")
        gait.sample().forces.sum()
        cregopt.evaluate(task, [gait.schedule], trajectories=True, threads=1)
        assert gait.to_dict()["feasible"] and cregopt.verify(gait).feasible
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    for _ in range(100):
        warm = call()
    for _ in range(200):
        last = call()
    # Units: kB, on macOS bytes. A call that leaked only its motion would leak tens of kB, 200 calls about 10 MB.
    assert last - warm < 2000 * (1024 if sys.platform == "darwin" else 1)
