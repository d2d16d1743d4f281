"""A robot for the search from a MuJoCo model."""

from __future__ import annotations

import itertools
from typing import Optional, Sequence

import numpy as np

from .. import ROBOTS, Error, Robot
from ._engine import Floats
from ._model import Machine, Path

#: Largest box about the nominal feet that is tried, half-widths as shares of the base's height.
BOX = np.array([0.48, 0.32, 0.32])
#: Share of the box that legs attain which the robot is given.
KEPT = 0.9
#: Distance that inverse kinematics may leave, m.
ATTAINED = 1e-4
#: A box smaller than this share of the largest is no reach.
SMALLEST = 0.05


def robot(model: Path, feet: Optional[Sequence[str]] = None) -> Robot:
    """A robot for the search whose plans fit a MuJoCo model.

    Parameters
    ----------
    model : path
        MuJoCo model (MJCF or URDF) with a free base on legs whose joints all have motors; geometry of its world is left out.
    feet : list of str, optional
        Geoms (balls or capsules), bodies or sites that are the feet, in the order that plans have; else the ends of legs that stand on the ground in
        the model's stance, front first and left first.

    Returns
    -------
    Robot
        Mass and composite inertia in the stance (base frame: centre of mass, axes of the model's first body), the feet's nominal places in it, and
        as reach the box whose corners all legs attain at once with joints in their ranges, with a tenth to spare. The stance is the keyframe
        ``home`` or another, or legs that are bent.

    Raises
    ------
    Error
        For a model that is no legged robot with motors, or that has no stance.
    ImportError
        Without MuJoCo.
    """
    machine = Machine(model, feet)
    nominal = machine.nominal_feet()
    height = float(-nominal[:, 2].mean())
    nominal[:, 2] = -height
    smallest, largest = SMALLEST, 1.0
    if height <= 0 or not _attains(machine, nominal, smallest * BOX * height):
        raise Error(f"the model {machine.name} has no stance from which its legs move: give it a keyframe 'home' in which it stands")
    if _attains(machine, nominal, largest * BOX * height):
        smallest = largest
    while largest - smallest > 0.01:
        middle = (smallest + largest) / 2
        if _attains(machine, nominal, middle * BOX * height):
            smallest = middle
        else:
            largest = middle
    return Robot.from_dict(
        {
            # A built-in robot is another one.
            "name": f"{machine.name}-imported" if machine.name in ROBOTS else machine.name,
            "mass": machine.mass,
            "inertia": machine.composite_inertia().tolist(),
            "base_height": height,
            "nominal_feet": nominal.tolist(),
            "reach": (KEPT * smallest * BOX * height).tolist(),
            "foot_radius": min(foot.radius for foot in machine.feet),
        }
    )


def _attains(machine: Machine, nominal: Floats, box: Floats) -> bool:
    """Whether all feet can be in each corner of a box about their nominal places at once, the base level."""
    balls = nominal + [[0, 0, foot.radius] for foot in machine.feet]
    for corner in itertools.product((-1.0, 1.0), repeat=3):
        left, pose = machine.inverse_kinematics(np.zeros(3), np.eye(3), balls + corner * box)
        if left > ATTAINED or not machine.within_ranges(pose):
            return False
    return True
