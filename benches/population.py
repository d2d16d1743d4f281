"""Schedules for the benchmarks in Python."""

import random

import cregopt


def population(task: cregopt.Task, candidates: int) -> list[list[list[float]]]:
    """Random schedules around a feasible trot of the task; the same for each call."""
    draw = random.Random(1)
    around = cregopt.search(task, gaits="trot", first=True, device="cpu").schedule
    schedules = []
    for _ in range(candidates):
        feet = [[phase * draw.uniform(0.9, 1.1) for phase in foot] for foot in around]
        schedules.append([[phase * sum(feet[0]) / sum(foot) for phase in foot] for foot in feet])
    return schedules
