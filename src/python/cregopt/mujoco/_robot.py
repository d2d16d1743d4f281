"""Robot description for the search, made from a MuJoCo model."""

from __future__ import annotations

import itertools
from typing import Any, Callable, Optional, Sequence

import numpy as np

from .. import ROBOTS, Error, Robot
from . import _rotation
from ._engine import Floats
from ._model import ATTAINED, Machine, Path

#: Half-widths of the largest box around the nominal feet that is tried, as shares of the base height.
BOX = np.array([0.48, 0.32, 0.32])
#: The same for feet with soles: to the rear, inwards, down; forwards, outwards, up. Shares of it that a walk needs.
SOLE_BOX = np.array([[0.3, 0.15, 0.08], [0.3, 0.25, 0.2]])
NEEDED = np.array([[0.57, 0.3, 0.57], [0.57, 0.4, 0.48]])
#: Points at which a box is checked: the corners; for soles those of a polyhedron inside the box, because a step is long when the foot is
#: at its middle height, and legs that bend one way attain no large box.
CORNERS = list(itertools.product((-1, 1), repeat=3))
SOLE_POINTS = [at for x, y, z in itertools.product((-1, 1), repeat=3) for at in ((x, y / 2, 0), (x / 2, y / 2, z), (0, y, z / 2))]
#: Directions in which the reach of a sole grows, in this order: indices into SOLE_BOX that grow at once; number of bisections.
GROWING, HALVINGS = ([(0, 0), (1, 0)], [(0, 0)], [(1, 0)], [(1, 2)], [(1, 1)], [(0, 1)], [(0, 2)]), 5
#: Largest yaws of a sole relative to the base, rad: the first with which a walk is possible; smallest distance between soles, m.
TURNS, APART = (0.3, 0.25, 0.2, 0.15, 0.1, 0.05), 0.02
#: Share of the largest attainable box that becomes the reach of the robot.
KEPT = 0.9
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
        first body). The reach is 90 % of the largest box whose corners all legs attain at once with their joints in range. The stance is the
        keyframe ``home``, another keyframe, or a pose with bent legs.

        Legs with six joints or more, whose last body has a flat lower side, stand on soles: rectangles inside the geoms that can be in contact. Then
        the robot has the equivalent mass of a leg, the stance has level soles, bent knees, and the centre of mass above the soles. The box is
        attained with level soles that are turned by up to ``sole.turn`` either way, except for its edges: of length, width and height, at most one
        is used in full at a time. It ends where soles would touch each other.

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
    if height <= 0:
        raise _no_stance(machine)
    described: dict[str, Any] = {
        # The names of built-in robots are reserved.
        "name": f"{machine.name}-imported" if machine.name in ROBOTS else machine.name,
        "mass": machine.mass,
        "inertia": machine.composite_inertia().tolist(),
        "base_height": height,
        "nominal_feet": nominal.tolist(),
    }
    soles = [foot.sole for foot in machine.feet if foot.sole is not None]
    if soles and not machine.soled:
        seen = ", ".join(f"{foot.name} ({'ball or point' if foot.sole is None else 'sole'})" for foot in machine.feet)
        raise Error(f"some feet of the model {machine.name} are soles, others are not: {seen}; name the feet (--feet)")
    if not soles:
        low, high = np.array([-1, 1])[:, None, None] * np.tile(BOX * height, (len(nominal), 1))
        share = _largest(lambda share: _attains(machine, nominal, share * low, share * high, CORNERS, (0.0,)), machine)
        described["reach"] = (KEPT * share * BOX * height).tolist()
        described["foot_radius"] = min(foot.radius for foot in machine.feet)
        return Robot.from_dict(described)
    length, width = min(sole.length for sole in soles), min(sole.width for sole in soles)
    low, high, turn = _sole_box(machine, nominal, width)
    described["reach"] = np.stack([low, high], axis=2).tolist()
    described["sole"] = {"length": length, "width": width, "turn": turn}
    described["leg_mass"] = machine.leg_mass()
    return Robot.from_dict(described)


def _no_stance(machine: Machine) -> Error:
    return Error(f"the model {machine.name} has no stance from which its legs move: give it a keyframe 'home' in which it stands")


def _largest(attained: Callable[[float], bool], machine: Machine) -> float:
    """Largest share, at most 1, for which ``attained`` is true. Raises Error if it is smaller than SMALLEST."""
    smallest, largest = SMALLEST, 1.0
    if not attained(smallest):
        raise _no_stance(machine)
    if attained(largest):
        return largest
    while largest - smallest > 0.01:
        middle = (smallest + largest) / 2
        if attained(middle):
            smallest = middle
        else:
            largest = middle
    return smallest


def _sole_box(machine: Machine, nominal: Floats, width: float) -> tuple[Floats, Floats, float]:
    """Reach of feet with soles: lowest and highest offsets from the nominal positions, m, both shape (feet, 3), and largest yaw of a sole, rad.

    The box and the yaw that a walk needs come first, then length, then the other directions: a leg that bends one way attains no large box.
    """
    height = float(-nominal[0, 2])
    # Feet on the right mirror those on the left.
    mirror = np.where(nominal[:, 1:2] < 0, [1.0, -1.0, 1.0], 1.0)
    gaps = [abs(one[1] - other[1]) for one, other in itertools.combinations(nominal, 2) if abs(one[0] - other[0]) < 2 * SOLE_BOX[0, 0] * height]
    inwards = max(0.0, (min(gaps, default=np.inf) - width - APART) / 2)
    largest = np.minimum(SOLE_BOX * height, [[np.inf, inwards, np.inf], [np.inf] * 3])

    def ends(box: Floats) -> tuple[Floats, Floats]:
        one, other = -box[0] * mirror, box[1] * mirror
        return np.minimum(one, other), np.maximum(one, other)

    def attains(box: Floats, turn: float) -> bool:
        return _attains(machine, nominal, *ends(box), SOLE_POINTS, (-turn, turn))

    box, needed = np.zeros((2, 3)), NEEDED * largest
    turn = next((turn for turn in TURNS if attains(needed, turn)), TURNS[-1])
    box = needed * _largest(lambda share: attains(share * needed, turn), machine)
    for growing in GROWING:
        grown = np.zeros((2, 3), dtype=bool)
        grown[tuple(np.transpose(growing))] = True
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            if attains(np.where(grown, box + middle * (largest - box), box), turn):
                low = middle
            else:
                high = middle
        box = np.where(grown, box + low * (largest - box), box)
    return (*ends(KEPT * box), turn)


def _attains(machine: Machine, nominal: Floats, low: Floats, high: Floats, points: Sequence[tuple[float, ...]], yaws: tuple[float, ...]) -> bool:
    """True if all feet can be at the same point of their boxes at once, for each point and yaw of the soles, with a level base.

    ``low`` and ``high``: offsets of the ends of the boxes from the nominal positions, m, shape (feet, 3). ``points``: coordinates along the
    axes, from -1 at the low ends to 1 at the high ones.
    """
    balls = nominal + [[0, 0, foot.radius] for foot in machine.feet]
    for point, yaw in itertools.product(np.array(points), yaws):
        soles = np.tile(_rotation.of_vector(np.array([0, 0, yaw])), (len(nominal), 1, 1))
        left, pose = machine.inverse_kinematics(np.zeros(3), np.eye(3), balls + np.where(point > 0, point * high, -point * low), soles)
        if left > ATTAINED or not machine.within_ranges(pose):
            return False
    return True
