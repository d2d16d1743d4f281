"""Command lines ``python -m cregopt.mujoco``, ``python -m cregopt.mujoco drive`` and ``python -m cregopt.mujoco dataset``; see ``--help``."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any, Optional, Sequence, Union

from .. import Error, Robot, Terrain
from . import DriveReport, Report, drive, export, play, play_dataset, random_drive, robot
from ._dataset import FORMS

UPRIGHT, FALLEN, BAD_INPUT = 0, 3, 4


def add_common(parser: argparse.ArgumentParser) -> None:
    """Adds the options that both command lines share."""
    parser.add_argument("--speed-limit", type=float, default=30.0, metavar="RAD/S", help="joint speed at which the motors have no torque left [default: 30]")
    parser.add_argument("--video", metavar="FILE", help="write an animation: .gif, .png or .webp")
    parser.add_argument("--viewer", action="store_true", help="show the simulation in a window")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m cregopt.mujoco",
        description="Plays a plan of `cregopt solve` on a robot in MuJoCo and reports the result, or writes the robot file for planning. "
        "`python -m cregopt.mujoco drive` drives a robot by commands, with gaits that are chosen online. `python -m cregopt.mujoco dataset` writes "
        "the motions of a data set as references for trainers.",
        epilog="Exit codes: 0 upright to the end, 2 usage, 3 fallen, 4 bad file or MuJoCo missing.",
    )
    parser.add_argument("trajectory", nargs="?", help="the plan: trajectory.json")
    parser.add_argument("--model", required=True, metavar="FILE", help="MuJoCo model of the robot")
    parser.add_argument("--feet", metavar="NAME,...", help="geoms, bodies or sites that are the feet, in the plan's order [default: found]")
    parser.add_argument("--friction", type=float, help="friction coefficient of the ground [default: the plan's]")
    parser.add_argument("--seed", type=int, help="seed of small disturbances of start, masses and friction [default: none]")
    add_common(parser)
    parser.add_argument("--robot", metavar="FILE", help="instead of playing, write the model's robot file for `cregopt solve --robot`: .json or .toml")
    return parser


def drive_arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m cregopt.mujoco drive",
        description="Drives a robot in MuJoCo by commands and reports the result. Gaits are chosen online, many times a second.",
        epilog="A value that begins with a minus sign follows an equals sign: --command=-0.2,0,0:5. Exit codes: 0 upright to the end, 2 usage, 3 fallen, 4 bad file or MuJoCo missing.",
    )
    parser.add_argument("--model", required=True, metavar="FILE", help="MuJoCo model of the robot")
    parser.add_argument("--feet", metavar="NAME,...", help="geoms, bodies or sites that are the feet [default: found]")
    parser.add_argument("--robot", metavar="FILE", help="robot of the planner, .json or .toml [default: made from the model]")
    parser.add_argument(
        "--command", metavar="VX,VY,YAW:S;...", help="velocity forward and to the left, m/s, yaw rate, rad/s, and duration, s [default: 0.5,0,0:5]"
    )
    parser.add_argument("--push", default="", metavar="T:FX,FY,FZ:S;...", help="time, s, force on the base, N, and duration, s")
    parser.add_argument("--random", type=float, metavar="S", help="random commands and pushes for at least this time, s, drawn by --seed")
    parser.add_argument("--terrain", metavar="NAME|FILE", help="terrain that the planner knows [default: flat]")
    parser.add_argument("--ground", metavar="NAME|FILE", help="terrain of the simulation [default: --terrain]")
    parser.add_argument("--friction", type=float, help="friction coefficient of the simulation [default: that of --terrain]")
    parser.add_argument(
        "--patch", default="", metavar="MU:X0,X1;...", help="friction coefficient of the simulation from x = X0 to X1, m, that planner and controller do not know"
    )
    parser.add_argument("--load", metavar="KG:X,Y", help="mass on the base that planner and controller do not know, and its place before and left of the centre of mass, m")
    parser.add_argument("--gait", metavar="NAME", help="family whose typical durations are kept [default: the planner chooses]")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="setting of cregopt.Planner, for example horizon=1")
    parser.add_argument("--rate", type=float, default=50.0, help="updates per second [default: 50]")
    parser.add_argument("--open-loop", action="store_true", help="plan from the plan instead of the measured state")
    parser.add_argument("--delay", type=float, default=0.0, metavar="S", help="age of the state when its plan comes into force, s [default: 0]")
    parser.add_argument("--noise", action="store_true", help="add noise to the planner's state")
    parser.add_argument("--seed", type=int, help="seed of small disturbances of start, masses and friction, of --random and of --noise [default: none]")
    add_common(parser)
    return parser


def dataset_arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m cregopt.mujoco dataset",
        description="Writes the motions of `cregopt dataset` as references of a MuJoCo model, in the files that trainers of policies read, "
        "or plays them.",
        epilog="Exit codes: 0 written, or upright to the end of all motions, 2 usage, 3 fallen, 4 bad file or MuJoCo missing.",
    )
    parser.add_argument("folder", help="folder of the data set")
    parser.add_argument("--robot", required=True, metavar="NAME", help="robot of the data set: name of its folder")
    parser.add_argument("--model", required=True, metavar="FILE", help="MuJoCo model of the robot, that of the trainer")
    parser.add_argument("--feet", metavar="NAME,...", help="geoms, bodies or sites that are the feet, in the robot's order [default: found]")
    parser.add_argument("--format", choices=FORMS, help=f"with --out: mjlab: one file per motion; loco-mujoco: one file [default: {FORMS[0]}]")
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--out", metavar="PATH", help="folder for mjlab, file (.npz) for loco-mujoco")
    action.add_argument("--play", action="store_true", help="play the motions on the model, which needs motors")
    parser.add_argument("--most", type=int, metavar="N", help="largest number of motions [default: all]")
    parser.add_argument("--seed", type=int, help="with --play: seed of small disturbances of start, masses and friction [default: none]")
    parser.add_argument("--json", action="store_true", help="with --play: print the reports as JSON")
    return parser


def run_dataset(given: Sequence[str]) -> int:
    parser = dataset_arguments()
    options = parser.parse_args(given)
    if options.play and options.format is not None:
        parser.error("--format needs --out")
    if not options.play and (options.json or options.seed is not None):
        parser.error("--seed and --json need --play")
    feet = options.feet.split(",") if options.feet else None
    try:
        if not options.play:
            print(export(options.folder, options.robot, options.model, options.out, options.format or FORMS[0], feet=feet, most=options.most))
            return UPRIGHT
        reports = play_dataset(options.folder, options.robot, options.model, feet=feet, most=options.most, seed=options.seed)
    except (Error, ImportError, OSError) as error:
        return refused(error)
    if options.json:
        print(json.dumps({name: report.to_dict() for name, report in reports.items()}, indent=1, allow_nan=False))
    else:
        for name, report in reports.items():
            print(f"{name}: {report.outcome}; {report.errors}")
        print(f"{sum(report.followed for report in reports.values())} of {len(reports)} motions followed")
    return UPRIGHT if all(report.upright for report in reports.values()) else FALLEN


def numbers(text: str, counts: Sequence[int], what: str) -> list[list[float]]:
    """Groups of numbers: ``:`` separates groups, ``,`` their numbers."""
    try:
        groups = [[float(number) for number in group.split(",")] for group in text.split(":")]
    except ValueError:
        groups = []
    if [len(group) for group in groups] != list(counts):
        raise Error(f"{what} {text!r}: must be {':'.join(','.join('N' * count) for count in counts)}")
    return groups


def setting(text: str) -> tuple[str, Any]:
    """Key and value of ``KEY=VALUE``."""
    key, equals, value = text.partition("=")
    if not equals:
        raise Error(f"--set {text!r}: must be KEY=VALUE")
    try:
        return key, json.loads(value)
    except ValueError:
        return key, value


def run_drive(given: Sequence[str]) -> int:
    parser = drive_arguments()
    options = parser.parse_args(given)
    if options.random is not None and options.command is not None:
        parser.error("give either --command or --random")
    feet = options.feet.split(",") if options.feet else None
    try:
        known = None if options.robot is None else Robot.from_file(options.robot)
        made = known or robot(options.model, feet)
        parts = [part for part in (options.command or "0.5,0,0:5").split(";") if part]
        of_commands = [numbers(part, (3, 1), "--command") for part in parts]
        commands = [((c[0], c[1], c[2]), seconds) for c, (seconds,) in of_commands]
        of_pushes = [numbers(part, (1, 3, 1), "--push") for part in options.push.split(";") if part]
        pushes = [(time, (f[0], f[1], f[2]), seconds) for (time,), f, (seconds,) in of_pushes]
        if options.random is not None:
            commands, more = random_drive(options.random, options.seed or 0, made.mass, float(made.to_dict()["base_height"]))
            pushes += more
        of_patches = [numbers(part, (1, 2), "--patch") for part in options.patch.split(";") if part]
        patches = [(value, x[0], x[1]) for (value,), x in of_patches]
        load = None
        if options.load is not None:
            (mass,), place = numbers(options.load, (1, 2), "--load")
            load = (mass, (place[0], place[1]))
        settings = dict(setting(text) for text in options.set)
        if options.gait is not None:
            settings.update(families=[options.gait], change_durations=False)
        report = drive(
            options.model,
            commands,
            pushes=pushes,
            feet=feet,
            robot=made,
            terrain=None if options.terrain is None else terrain_of(options.terrain),
            ground=None if options.ground is None else terrain_of(options.ground),
            friction=options.friction,
            patches=patches,
            load=load,
            seed=options.seed,
            rate=options.rate,
            open_loop=options.open_loop,
            delay=options.delay,
            noise=options.noise,
            settings=settings,
            speed_limit=options.speed_limit,
            video=options.video,
            viewer=options.viewer,
        )
    except (Error, ImportError, OSError) as error:
        return refused(error)
    return printed(report, options.json)


def refused(error: Exception) -> int:
    """Prints an error. Returns the exit code."""
    print(f"error: {error}", file=sys.stderr)
    return BAD_INPUT


def printed(report: Union[Report, DriveReport], as_json: bool) -> int:
    """Prints a report. Returns the exit code."""
    print(json.dumps(report.to_dict(), indent=1, allow_nan=False) if as_json else report)
    return UPRIGHT if report.upright else FALLEN


def terrain_of(name: str) -> Terrain:
    """Terrain with a name, or of a file."""
    return Terrain.from_file(name) if name.endswith((".json", ".toml")) else Terrain(name)


def main(given: Optional[Sequence[str]] = None) -> int:
    given = sys.argv[1:] if given is None else given
    if given and given[0] == "drive":
        return run_drive(given[1:])
    if given and given[0] == "dataset":
        return run_dataset(given[1:])
    parser = arguments()
    options = parser.parse_args(given)
    if (options.trajectory is None) == (options.robot is None):
        parser.error("give either a trajectory or --robot")
    feet = options.feet.split(",") if options.feet else None
    try:
        if options.robot is not None:
            made = robot(options.model, feet)
            made.save(options.robot)
            print(f"{options.robot}: {made.mass:.2f} kg, {made.feet} feet")
            return UPRIGHT
        report = play(
            options.trajectory,
            options.model,
            feet=feet,
            friction=options.friction,
            seed=options.seed,
            speed_limit=options.speed_limit,
            video=options.video,
            viewer=options.viewer,
        )
    except (Error, ImportError, OSError) as error:
        return refused(error)
    return printed(report, options.json)


if __name__ == "__main__":
    sys.exit(main())
