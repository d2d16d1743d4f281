"""Rotations as 3 x 3 matrices, body to world."""

from __future__ import annotations

import numpy as np

from ._engine import Floats


def of_quaternions(quaternions: Floats) -> Floats:
    """Matrices, shape (n, 3, 3), of unit quaternions w, x, y, z, shape (n, 4)."""
    w, v = quaternions[:, :1, None], quaternions[:, 1:]
    inner, outer = (v**2).sum(1)[:, None, None], v[:, :, None] * v[:, None, :]
    matrices: Floats = (w**2 - inner) * np.eye(3) + 2 * outer + 2 * w * crosses(v)
    return matrices


def crosses(vectors: Floats) -> Floats:
    """Skew-symmetric matrices S with S u = v x u, shape (n, 3, 3), of vectors v, shape (n, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)


def between(start: Floats, end: Floats) -> Floats:
    """Rotation vector, world frame, rad, that rotates the attitude ``start`` into ``end``. Valid for angles below pi."""
    turn = end @ start.T
    twice_sine = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    length = float(np.linalg.norm(twice_sine))
    angle = np.arctan2(length, np.trace(turn) - 1)
    return twice_sine * (angle / length if length > 1e-9 else 0.5)


def upright(directions: Floats, yaw: float = 0.0) -> Floats:
    """Rotation matrix whose third column is the given unit vector, which must point up, and whose first column is ahead at a yaw, rad."""
    x = np.cross([-np.sin(yaw), np.cos(yaw), 0.0], directions)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(directions, x), directions], axis=1)


def of_vector(turn: Floats) -> Floats:
    """Matrix of a rotation vector, rad."""
    angle = float(np.linalg.norm(turn))
    half = 0.5 * np.sinc(angle / (2 * np.pi)) * turn
    return of_quaternions(np.array([[np.cos(angle / 2), *half]]))[0]  # type: ignore[no-any-return]
