"""Robot description for the search, made from a MuJoCo model."""

from __future__ import annotations

import itertools
from typing import Optional, Sequence

import numpy as np

from .. import ROBOTS, Error, Robot
from ._engine import Floats
from ._model import Machine, Path

#: Half-widths of the largest box around the nominal feet that is tried, as shares of the base height.
BOX = np.array([0.48, 0.32, 0.32])
#: Share of the largest attainable box that becomes the reach of the robot.
KEPT = 0.9
#: Largest remaining error of inverse kinematics, m, with which a position counts as attained.
ATTAINED = 1e-4
#: Smallest acceptable box, as a share of the largest.
SMALLEST = 0.05


def robot(model: Path, feet: Optional[Sequence[str]] = None) -> Robot:
    """Robot for :class:`cregopt.Task`, whose plans fit a MuJoCo model.

    Parameters
    ----------
    model : path
        MuJoCo model (MJCF or URDF) with a free base and legs, all of whose joints have motors. The geometry of its world is ignored.
    feet : list of str, optional
        Geoms (balls or capsules), bodies or sites that are the feet, in the order of the plans. Default: the ends of the legs that are on the ground in
        the model's stance, front before rear and left before right.

    Returns
    -------
    Robot
        Robot with the mass, and with the composite inertia and the nominal feet of the stance (base frame: centre of mass, axes of the model's
        first body). The reach is 90 % of the largest box whose corners all legs attain at once with their joints in range. The stance is the keyframe
        ``home``, another keyframe, or a pose with bent legs.

    Raises
    ------
    Error
        If the model is not a legged robot with motors, or has no stance.
    ImportError
        If MuJoCo is not installed.
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
            # The names of built-in robots are reserved.
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
    """True if all feet can be at the same corner of a box around their nominal positions at once, for each corner, with a level base."""
    balls = nominal + [[0, 0, foot.radius] for foot in machine.feet]
    for corner in itertools.product((-1.0, 1.0), repeat=3):
        left, pose = machine.inverse_kinematics(np.zeros(3), np.eye(3), balls + corner * box)
        if left > ATTAINED or not machine.within_ranges(pose):
            return False
    return True
