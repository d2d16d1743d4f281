"""Success of default gaits in MuJoCo over robots, tasks, seeds and frictions; each gait is played by ``cregopt.mujoco``.

    python benches/in_mujoco.py MODEL.xml... [--preset NAME] [--gait FAMILY,...] [--seeds N] [--friction MU...] [--out FILE.jsonl]

Each gait is searched on flat ground with the defaults of ``cregopt solve``, and played with each friction and with disturbances by the seed of the
search. Prints one line per play and a table of all plays.
"""

from __future__ import annotations

import argparse
import collections
import json
import math
import time
from typing import Any, Iterable, Optional, Sequence

import cregopt
import cregopt.mujoco

TASKS = {
    "1.5 m": ((1.5, 0.0), 0.0),
    "3 m": ((3.0, 0.0), 0.0),
    "1 m, quarter turn": ((1.0, 0.5), math.pi / 2),
    "1 m sideways": ((0.0, 1.0), 0.0),
}
FRICTIONS = (0.5, 0.8, 1.0)

HEAD = """\
| | gaits | upright | followed | base off, cm | rms | deg | slip in a stance, cm | torque, % of limit | time at a limit, % | joint speed, rad/s |
|---|---|---|---|---|---|---|---|---|---|---|"""


def plays(model: str, seeds: int, frictions: Sequence[float], preset: Optional[str], gaits: str) -> Iterable[dict[str, Any]]:
    """Yields one dictionary per play of a robot, with the conditions and the report."""
    robot = cregopt.mujoco.robot(model)
    for name, (goal, yaw) in TASKS.items():
        task = cregopt.Task(robot, cregopt.Terrain("flat"), goal=goal, yaw=yaw)
        for seed in range(1, seeds + 1):
            gait = cregopt.search(task, seed=seed, preset=preset, gaits=gaits, threads=1)
            for friction in frictions:
                conditions = {"robot": robot.name, "task": name, "seed": seed, "friction": friction, "family": gait.family}
                if not gait.feasible:
                    yield {**conditions, "found": False}
                    continue
                report = cregopt.mujoco.play(gait, model, friction=friction, seed=seed)
                yield {**conditions, **report.to_dict(), "friction": friction, "found": True}


def row(name: str, rows: list[dict[str, Any]]) -> str:
    """Line of the table."""
    found = [r for r in rows if r["found"]]
    upright = [r for r in found if r["upright"]]

    def spread(key: str, scale: float) -> str:
        """Median / largest value of the plays that stay upright."""
        values = sorted(scale * r[key] for r in upright)
        return f"{values[len(values) // 2]:.3g} / {values[-1]:.3g}" if values else "-"

    families = ", ".join(f"{family or 'free'} {n}" for family, n in collections.Counter(r["family"] for r in found).items())
    columns = [
        name,
        families,
        f"{len(upright)} of {len(rows)}",
        str(sum(r["followed"] for r in found)),
        spread("position_error_max", 100),
        spread("position_error_rms", 100),
        spread("attitude_error_max", 180 / math.pi),
        spread("slip_max", 100),
        spread("torque_share", 100),
        spread("torque_saturated", 100),
        spread("joint_speed", 1),
    ]
    return f"| {' | '.join(columns)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="+")
    parser.add_argument("--preset")
    parser.add_argument("--gait", default="all")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--friction", type=float, nargs="+", default=FRICTIONS)
    parser.add_argument("--out", help="file for all reports, one JSON object per line")
    options = parser.parse_args()
    begun, rows = time.monotonic(), []
    for model in options.models:
        for play in plays(model, options.seeds, options.friction, options.preset, options.gait):
            rows.append(play)
            outcome = "no gait" if not play["found"] else play["fall"] or ("followed" if play["followed"] else "upright")
            print(play["robot"], play["task"], play["seed"], play["friction"], play["family"], outcome, f"{time.monotonic() - begun:.0f} s", flush=True)
            if options.out:
                with open(options.out, "a") as file:
                    file.write(json.dumps(play) + "\n")
    print("\n" + HEAD)
    for key in ("robot", "task", "friction"):
        for value in dict.fromkeys(r[key] for r in rows):
            print(row(f"friction {value}" if key == "friction" else value, [r for r in rows if r[key] == value]))
    print(row("all", rows))
    for reason, n in collections.Counter(r.get("fall") or "no gait" for r in rows if not r.get("upright")).most_common():
        print(f"{n} not upright: {reason}")


if __name__ == "__main__":
    main()
