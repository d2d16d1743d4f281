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
#: Heights of the centre of mass below the largest one that are tried, as shares of it.
CROUCHES = (0.05, 0.06, 0.07, 0.08, 0.1)
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
    soles = [foot.sole for foot in machine.feet if foot.sole is not None]
    if soles and not machine.soled:
        seen = ", ".join(f"{foot.name} ({'ball or point' if foot.sole is None else 'sole'})" for foot in machine.feet)
        raise Error(f"some feet of the model {machine.name} are soles, others are not: {seen}; name the feet (--feet)")
    if -machine.nominal_feet()[:, 2].mean() <= 0:
        raise _no_stance(machine)
    if soles:
        length, width = (round(min(lengths), 6) for lengths in zip(*((sole.length, sole.width) for sole in soles)))
        low, high, turn = _sole_box(machine, width)
        reach = np.stack([low, high], axis=2)
        own: dict[str, Any] = {"sole": {"length": length, "width": width, "turn": turn}, "leg_mass": machine.leg_mass()}
    nominal = machine.nominal_feet()
    height = float(-nominal[:, 2].mean())
    nominal[:, 2] = -height
    if not soles:
        low, high = np.array([-1, 1])[:, None, None] * np.tile(BOX * height, (len(nominal), 1))
        share = _largest(lambda share: _attains(machine, nominal, share * low, share * high, CORNERS, (0.0,)), machine)
        reach, own = KEPT * share * BOX * height, {"foot_radius": min(foot.radius for foot in machine.feet)}
    return Robot.from_dict(
        {
            # The names of built-in robots are reserved.
            "name": f"{machine.name}-imported" if machine.name in ROBOTS else machine.name,
            "mass": machine.mass,
            "inertia": machine.composite_inertia().tolist(),
            "base_height": height,
            "nominal_feet": nominal.tolist(),
            "reach": reach.tolist(),
            **own,
        }
    )


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


class _Soles:
    """Reach of a model that stands on soles, in its present stance. A box of reach is an array of lengths in the order of SOLE_BOX, m."""

    def __init__(self, machine: Machine, width: float) -> None:
        self.machine, self.nominal = machine, machine.nominal_feet()
        height = float(-self.nominal[0, 2])
        sides = self.nominal[:, 1]
        # Feet on the right mirror those on the left.
        self.mirror = np.where(sides[:, None] < 0, [1.0, -1.0, 1.0], 1.0)
        gap = min((abs(one - other) for one, other in itertools.combinations(sides, 2) if one * other < 0), default=np.inf)
        #: Largest box that is tried, and the box that a walk needs.
        self.largest = np.minimum(SOLE_BOX * height, [[np.inf, max(0.0, (gap - width - APART) / 2), np.inf], [np.inf] * 3])
        self.needed = NEEDED * self.largest

    def ends(self, box: Floats) -> tuple[Floats, Floats]:
        """Lowest and highest offsets of the feet from their nominal positions, m, both shape (feet, 3)."""
        one, other = -box[0] * self.mirror, box[1] * self.mirror
        return np.minimum(one, other), np.maximum(one, other)

    def attains(self, box: Floats, turn: float) -> bool:
        """True if the feet attain the points of a box with soles that are turned by ``turn``, rad, either way."""
        return _attains(self.machine, self.nominal, *self.ends(box), SOLE_POINTS, (-turn, turn))


def _sole_box(machine: Machine, width: float) -> tuple[Floats, Floats, float]:
    """Reach of feet with soles: lowest and highest offsets from the nominal positions, m, both shape (feet, 3), and largest yaw of a sole, rad.

    The model takes the highest stance in which it attains, with the largest yaw, the box that a walk needs. The box grows from there in one
    direction after the other: a leg that bends one way attains no large box.
    """
    for turn, crouch in itertools.product(TURNS, CROUCHES):
        machine.stance = machine.crouched(crouch)
        soles = _Soles(machine, width)
        if soles.attains(soles.needed, turn):
            break
    box = soles.needed * _largest(lambda share: soles.attains(share * soles.needed, turn), machine)
    for growing in GROWING:
        grown = np.zeros((2, 3), dtype=bool)
        grown[tuple(np.transpose(growing))] = True
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            if soles.attains(np.where(grown, box + middle * (soles.largest - box), box), turn):
                low = middle
            else:
                high = middle
        box = np.where(grown, box + low * (soles.largest - box), box)
    return (*soles.ends(KEPT * box), turn)


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
