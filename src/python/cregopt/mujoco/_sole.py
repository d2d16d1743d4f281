"""Flat soles of feet: rectangles in the collision geometry of a body."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, NamedTuple, Optional

import numpy as np

from ._engine import Floats, mj

#: Largest angle between the normal of a sole and the vertical in the pose in which soles are searched, rad.
TILT = float(np.radians(30.0))
#: Height differences of a flat sole, m.
FLAT = 5e-4
#: Smallest length and width of a sole, m.
SMALLEST = (0.02, 0.01)
#: Directions in which the lowest points are searched: inclinations to the vertical, rad, and number of azimuths.
INCLINATIONS, AZIMUTHS = (0.02, 0.1, 0.25, 0.5), 24
#: Number of points on the rim of a cylinder, and of steps between the corners of a sole's polygon.
RIM, STEPS = 24, 40


@dataclass(frozen=True)
class Sole:
    """Rectangle on which a foot stands. Its centre is that of the foot."""

    #: Attitude of the sole in the frame of the body: columns forward, left and up, shape (3, 3).
    axes: Floats
    #: Length forward and width, m.
    length: float
    width: float

    def corners(self, share: float = 1.0) -> Floats:
        """Corners of the concentric rectangle of ``share`` the size, relative to the centre, axes of the sole, m, shape (4, 3)."""
        x, y = share / 2 * self.length, share / 2 * self.width
        return np.array([[x, y, 0], [x, -y, 0], [-x, y, 0], [-x, -y, 0]])


class Rectangle(NamedTuple):
    """Level or inclined rectangle, world frame."""

    #: Centre, m, shape (3,), and columns forward, left and up, shape (3, 3).
    center: Floats
    axes: Floats
    #: Length forward and width, m.
    length: float
    width: float


def balls(model: Any, data: Any, geom: int) -> tuple[Floats, float]:
    """Balls whose convex hull is a geom: centres in the world frame, m, shape (n, 3), and radius, m. No balls for a geom of another kind."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    of, local, radius = mj.mjtGeom, np.zeros((0, 3)), 0.0
    if kind == of.mjGEOM_SPHERE:
        local, radius = np.zeros((1, 3)), float(size[0])
    elif kind == of.mjGEOM_CAPSULE:
        local, radius = np.array([[0, 0, -size[1]], [0, 0, size[1]]]), float(size[0])
    elif kind == of.mjGEOM_BOX:
        local = size * np.array(list(itertools.product((-1, 1), repeat=3)))
    elif kind == of.mjGEOM_CYLINDER:
        angles = np.arange(RIM) * 2 * np.pi / RIM
        rim = size[0] * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
        local = np.concatenate([rim - [0, 0, size[1]], rim + [0, 0, size[1]]])
    elif kind == of.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        local = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(float)
    return data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T, radius


def find(centers: Floats, radii: Floats) -> Optional[Rectangle]:
    """Largest rectangle, along the x axis, on the lower side of the convex hull of balls, or None if it has no flat side.

    ``centers``: world frame, m, shape (n, 3). ``radii``: m, shape (n,). Of several flat sides it is the largest.
    """
    if len(centers) < 3:
        return None
    tilts, turns = np.array(INCLINATIONS)[:, None], np.arange(AZIMUTHS) * 2 * np.pi / AZIMUTHS
    directions = np.stack(np.broadcast_arrays(np.sin(tilts) * np.cos(turns), np.sin(tilts) * np.sin(turns), -np.cos(tilts)), axis=-1)
    lowest = np.unique(np.argmax(directions.reshape(-1, 3) @ centers.T + radii, axis=1))
    down = _flat_side(centers[lowest], radii[lowest])
    if down is None:
        return None
    heights = centers @ down + radii
    touching = heights > heights.max() - 2 * FLAT
    points = centers[touching] + radii[touching, None] * down
    forward = np.array([1.0, 0.0, 0.0]) - down[0] * down
    forward /= np.linalg.norm(forward)
    axes = np.stack([forward, np.cross(-down, forward), -down], axis=1)
    (x, y), length, width = _rectangle(points @ axes[:, :2])
    if length < SMALLEST[0] or width < SMALLEST[1]:
        return None
    return Rectangle(axes @ [x, y, float(np.mean(points @ axes[:, 2]))], axes, length, width)


def _flat_side(centers: Floats, radii: Floats) -> Optional[Floats]:
    """Unit normal, outwards, of the plane that touches three balls from below and cuts off no other; of the three furthest apart."""
    triples = np.array(list(itertools.combinations(range(len(centers)), 3)), dtype=int).reshape(-1, 3)
    edges = centers[triples[:, 1:]] - centers[triples[:, :1]]
    normals = np.cross(edges[:, 0], edges[:, 1])
    doubled = np.linalg.norm(normals, axis=1)
    kept = doubled > 2 * SMALLEST[0] * SMALLEST[1] / 2
    triples, edges, normals, doubled = triples[kept], edges[kept], normals[kept], doubled[kept]
    normals *= -np.sign(normals[:, 2:]) / doubled[:, None]
    # In the plane of the centres the normal compensates the differences of the radii.
    within = np.linalg.pinv(edges) @ (radii[triples[:, :1]] - radii[triples[:, 1:]])[:, :, None]
    within = within[:, :, 0]
    normals = within + np.sqrt(np.maximum(1 - (within**2).sum(1), 0))[:, None] * normals
    heights = normals @ centers.T + radii
    plane = np.take_along_axis(heights, triples[:, :1], axis=1)[:, 0]
    valid = (heights.max(axis=1) < plane + FLAT) & (normals[:, 2] < -np.cos(TILT))
    if not valid.any():
        return None
    best: Floats = normals[np.argmax(np.where(valid, doubled, 0))]
    return best / float(np.linalg.norm(best))


def _rectangle(points: Floats) -> tuple[Floats, float, float]:
    """Rectangle of the largest area along the axes in the convex hull of points, shape (n, 2): centre, length along x, width along y."""
    ends = np.unique(points[:, 0])
    x = np.unique(np.concatenate([ends, np.linspace(ends[0], ends[-1], STEPS + 1)]))
    i, j = np.nonzero(points[:, None, 0] < points[None, :, 0])
    low, high = np.full(len(x), np.inf), np.full(len(x), -np.inf)
    for at, y in points:
        here = np.searchsorted(x, at)
        low[here], high[here] = min(low[here], y), max(high[here], y)
    if len(i):
        share = (x[:, None] - points[i, 0]) / (points[j, 0] - points[i, 0])
        y = np.where((share >= 0) & (share <= 1), (1 - share) * points[i, 1] + share * points[j, 1], np.nan)
        low, high = np.fmin(low, np.nanmin(y, axis=1)), np.fmax(high, np.nanmax(y, axis=1))
    top, bottom = np.minimum(high[:, None], high), np.maximum(low[:, None], low)
    area = np.maximum(x - x[:, None], 0) * np.maximum(top - bottom, 0)
    first, last = np.unravel_index(int(np.argmax(area)), area.shape)
    center = np.array([x[first] + x[last], bottom[first, last] + top[first, last]]) / 2
    return center, float(x[last] - x[first]), float(top[first, last] - bottom[first, last])
