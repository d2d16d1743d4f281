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
SOLE_BOX = np.array([[0.3, 0.15, 0.08], [0.3, 0.25, 0.25]])
NEEDED = np.array([[0.57, 0.3, 0.57], [0.57, 0.4, 0.384]])
#: Points at which a box is checked: the corners; for soles those of a polyhedron inside the box, because a step is long when the foot is
#: at its middle height, and legs that bend one way attain no large box.
CORNERS = list(itertools.product((-1, 1), repeat=3))
POLYHEDRON = np.array([[1, 0.5, 0], [0.5, 0.5, 1], [0, 1, 0.5]])
SOLE_POINTS = [tuple(signs * point) for signs in np.array(CORNERS) for point in POLYHEDRON]
#: Outward normals of the faces of the reach of a sole in the order in which they grow: x forward, y outward, z up. The last two bound y. Diagonal
#: faces cut the corners of a box, which legs that bend one way do not attain.
FACES = np.array(
    [[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1], [0.6, 0, 0.8], [-0.6, 0, -0.8], [-0.6, 0, 0.8], [0.6, 0, -0.8], [0, 1, 0], [0, -1, 0]], dtype=float
)
#: First growth step of a face relative to its largest distance; number of times that it is halved; parts of an edge whose ends are checked.
FIRST_STEP, HALVINGS, PARTS = 0.125, 4, 4
#: Heights of the centre of mass below the largest one that are tried, as shares of it.
CROUCHES = (0.05, 0.06, 0.07, 0.08, 0.1)
#: Largest yaws of a sole relative to the base, rad: the first with which a walk is possible; smallest distance between soles, m.
TURNS, APART = (0.3, 0.25, 0.2, 0.15, 0.1, 0.05), 0.02
#: Share of the attained distances that becomes the reach of the robot.
KEPT = 0.9
#: Smallest acceptable box, as a share of the largest.
SMALLEST = 0.05


def robot(model: Path, feet: Optional[Sequence[str]] = None) -> Robot:
    """Robot for :class:`cregopt.Task`, whose plans fit a MuJoCo model.

    Parameters
    ----------
    model : path
        MuJoCo model with a free base and legs, all of whose joints have motors, or URDF file, which gets both. The geometry of its world is
        ignored.
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
        the robot has the equivalent mass of a leg, the stance has level soles, bent knees, and the centre of mass above the soles. The reach is a
        box whose edges along y are cut by diagonal faces. It is attained with level soles that are turned by up to ``sole.turn`` either way,
        except that length and width are not used in full at a time. It ends where soles would touch each other.

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
        reach, turn = _sole_reach(machine, width)
        own: dict[str, Any] = {"sole": {"length": length, "width": width, "turn": turn}, "leg_mass": machine.leg_mass()}
    nominal = machine.nominal_feet()
    height = float(-nominal[:, 2].mean())
    nominal[:, 2] = -height
    if not soles:
        low, high = np.array([-1, 1])[:, None, None] * np.tile(BOX * height, (len(nominal), 1))
        share = _largest(lambda share: _attains(machine, nominal, share * low, share * high, CORNERS, (0.0,)), machine)
        reach, own = (KEPT * share * BOX * height).tolist(), {"foot_radius": min(foot.radius for foot in machine.feet)}
    return Robot.from_dict(
        {
            # The names of built-in robots are reserved.
            "name": f"{machine.name}-imported" if machine.name in ROBOTS else machine.name,
            "mass": machine.mass,
            "inertia": machine.composite_inertia().tolist(),
            "base_height": height,
            "nominal_feet": nominal.tolist(),
            "reach": reach,
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
    """Reach of a model that stands on soles, in its present stance. A box is an array of lengths in the order of SOLE_BOX, m; faces are an array
    of the distances of FACES from the nominal position, m."""

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

    def attains(self, box: Floats, turn: float, points: Sequence[tuple[float, ...]] = SOLE_POINTS) -> bool:
        """True if the feet attain points of a box with soles that are turned by ``turn``, rad, either way."""
        one, other = -box[0] * self.mirror, box[1] * self.mirror
        return _attains(self.machine, self.nominal, np.minimum(one, other), np.maximum(one, other), points, (-turn, turn))

    def attains_faces(self, faces: Floats, turn: float) -> bool:
        """True if the feet attain the points of faces: corners and edges of the outline at half the width, and the width at half the height."""
        corners = _outline(faces)
        points = [(0.0, y, z) for y in (-1.0, 1.0) for z in (-faces[3] / 2, faces[2] / 2)]
        for start, end in zip(corners, np.roll(corners, -1, axis=0)):
            for share in np.arange(PARTS) / PARTS:
                x, z = start + share * (end - start)
                points += [(x, -0.5, z), (x, 0.5, z)]
        # x and z are in m, y is a share of the width.
        return self.attains(np.array([[1.0, faces[9], 1.0], [1.0, faces[8], 1.0]]), turn, points)

    def grown(self, turn: float) -> Floats:
        """Faces of the reach: they grow in turn from a share of the box that a walk needs."""
        start, largest = _around(self.needed, POLYHEDRON), _around(self.largest, np.ones((1, 3)))
        faces = start * _largest(lambda share: self.attains_faces(share * start, turn), self.machine)
        halvings = np.zeros(len(FACES), dtype=int)
        while (halvings <= HALVINGS).any():
            for face in np.flatnonzero(halvings <= HALVINGS):
                more = faces.copy()
                more[face] = min(faces[face] + FIRST_STEP * largest[face] / 2 ** halvings[face], largest[face])
                # A face that the others cut off would grow without gain.
                bounds = FACES[face, 1] != 0 or (_outline(more) @ FACES[face, ::2]).max() > more[face] - 1e-9
                if more[face] > faces[face] and bounds and self.attains_faces(more, turn):
                    faces = more
                else:
                    halvings[face] += 1
        return faces


def _around(box: Floats, points: Floats) -> Floats:
    """Distances of FACES that touch the outermost of some points of a box, whose coordinates are shares of its sides, m."""
    sides = np.where(FACES > 0, box[1], box[0])
    return np.asarray((abs(FACES) * sides @ points.T).max(axis=1))


def _outline(faces: Floats) -> Floats:
    """Corners of faces in the x-z plane, in order, m, shape (corners, 2)."""
    flat = FACES[:8, ::2]
    pairs = [pair for pair in itertools.combinations(range(8), 2) if abs(np.linalg.det(flat[list(pair)])) > 1e-9]
    corners = np.array([np.linalg.solve(flat[list(pair)], faces[list(pair)]) for pair in pairs])
    corners = corners[(corners @ flat.T < faces[:8] + 1e-9).all(axis=1)]
    return np.asarray(corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))])


def _sole_reach(machine: Machine, width: float) -> tuple[list[dict[str, Any]], float]:
    """Reach of feet with soles, as in the file of a robot, and largest yaw of a sole, rad.

    The model takes the highest stance in which it attains, with the largest yaw, the box that a walk needs. The faces of the reach grow from there.
    """
    for turn, crouch in itertools.product(TURNS, CROUCHES):
        machine.stance = machine.crouched(crouch)
        soles = _Soles(machine, width)
        if soles.attains(soles.needed, turn):
            break
    soles.needed *= _largest(lambda share: soles.attains(share * soles.needed, turn), machine)
    faces = KEPT * soles.grown(turn)
    # Sides end where the diagonals leave nothing of them.
    faces[:8] = (_outline(faces) @ FACES[:8, ::2].T).max(axis=0)

    def slab(face: int) -> list[float]:
        return [float(-faces[face + 1]), float(faces[face])]

    diagonals = [{"normal": FACES[face].tolist(), "sides": slab(face)} for face in (4, 6)]
    y = slab(8)
    return [{"sides": [slab(0), y if mirror > 0 else [-y[1], -y[0]], slab(2)], "diagonals": diagonals} for mirror in soles.mirror[:, 1]], turn


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
