"""Terrain of a plan as MuJoCo geometry."""

from __future__ import annotations

from typing import Any, Optional, Sequence

import numpy as np

from .. import Terrain
from ._engine import Floats, mj

#: Name of the ground's geom, which no model uses; with patches, the further geoms have a number after it.
NAME = "cregopt ground"
#: Distance between height samples of uneven ground, m. A larger distance rounds off edges.
CELL = 0.02
#: Width of ground around the planned positions of the feet, m.
MARGIN = 1.0
#: Largest number of height samples along one side.
SAMPLES = 1000
#: Depth below the lowest planned foot position at which the ground is cut off, m.
DEPTH = 1.0
#: Half of the length of flat ground, m.
FLAT = 50.0
#: Most strips of which the ground may consist; the distance between the heights in which they are searched on ground that is no grid, and
#: the number of places across x where these are compared; the height by which a strip may bend; the height by which a box may come out of
#: the ground, where it meets the next one; and the thinnest box, m.
STRIPS, FINE, ACROSS, BENT, OUTSIDE, THINNEST = 50, 2e-3, 9, 1e-7, 1e-6, 0.01
#: Colour of patches, by which that of the ground is multiplied.
TINT = [0.65, 0.8, 1.0, 1.0]

#: Part of the ground with its own friction coefficient: friction, and the range of x that it covers, m.
Patch = tuple[float, float, float]


def add(spec: Any, terrain: Terrain, friction: float, feet: Floats, patches: Sequence[Patch] = ()) -> list[str]:
    """Adds the ground around the foot positions ``feet``, shape (n, feet, 3), m, to a model.

    Flat ground is a plane. Ground that consists of plane strips across x is boxes, with which soles have all their contacts; MuJoCo gives a
    geom at most 50 contacts with a height field. Other ground is a height field. Returns the names of the geoms. Patches do not overlap.
    """
    _light(spec)
    if not patches and _flat(terrain):
        spec.worldbody.add_geom(type=mj.mjtGeom.mjGEOM_PLANE, size=[FLAT, FLAT, 0.1], **_settings(NAME, friction))
        return [NAME]
    low, high = (-FLAT, FLAT) if _flat(terrain) else (float(feet[..., 0].min()) - MARGIN, float(feet[..., 0].max()) + MARGIN)
    floor = float(feet[..., 2].min()) - DEPTH
    ends = sorted({low, high, *(float(np.clip(end, low, high)) for _, *range in patches for end in range)})
    strips = _strips(terrain, ends, feet, floor)
    names: list[str] = []
    for start, end in zip(ends, ends[1:]):
        inside = [of for of, first, last in patches if first < (start + end) / 2 < last]
        of_part = [strip for strip in strips or [] if start <= strip[0][0, 0] < end]
        for strip in of_part if strips else [None]:
            names.append(f"{NAME} {len(names)}" if names else NAME)
            settings = _settings(names[-1], *(inside or [friction]))
            if inside:
                settings["rgba"] = TINT
            if strip is None:
                _add_heights(spec, terrain, feet, (start, end), settings, bool(patches))
            else:
                _add_strip(spec, *strip, settings)
    return names


def _strips(terrain: Terrain, ends: Sequence[float], feet: Floats, floor: float) -> Optional[list[tuple[Floats, float]]]:
    """Plane strips across x of which the ground consists: the points (x, z) at both ends of each, shape (2, 2), and the thickness that it may
    have, m. None if the ground has others, or edges that are too sharp.

    ``ends``: coordinates x between which it is needed, all of which are ends of strips. ``floor``: height at which it is cut off, m.
    """
    low, high = ends[0], ends[-1]
    shape = terrain.to_dict()["shape"]
    if "grid" in shape:
        heights = np.array(shape["grid"]["heights"])
        if np.ptp(heights, axis=1).max() > 0:
            return None
        start, stop = (float(shape["grid"][side][0]) for side in ("low", "high"))
        xs = start + (stop - start) / len(heights) * np.arange(len(heights))
    else:
        xs = np.array([]) if _flat(terrain) else np.arange(low, high, FINE)
        sides = np.linspace(feet[..., 1].min() - MARGIN, feet[..., 1].max() + MARGIN, ACROSS)
        if any(terrain.height(x, y) != terrain.height(x, sides[0]) for x in xs[:: ACROSS] for y in sides):
            return None
    xs = np.unique(np.concatenate([xs[(low < xs) & (xs < high)], ends]))
    points = np.array([[x, max(terrain.height(x, 0.0), floor)] for x in xs])
    slopes = np.diff(points[:, 1]) / np.diff(points[:, 0])
    corner = np.abs(np.diff(slopes)) * np.minimum(np.diff(xs)[:-1], np.diff(xs)[1:]) > BENT
    kept = points[[0, *(np.flatnonzero(corner | np.isin(xs[1:-1], ends)) + 1), -1]]
    if len(kept) > STRIPS:
        return None
    strips = [(kept[i : i + 2], _thickness(terrain, kept[i : i + 2], floor)) for i in range(len(kept) - 1)]
    return strips if all(thickness >= THINNEST for _, thickness in strips) else None


def _thickness(terrain: Terrain, strip: Floats, floor: float) -> float:
    """Thickness, at most DEPTH, with which a strip does not come out of the ground, m; less than THINNEST if it always does."""
    thickness, shares = DEPTH, np.linspace(0, 1, 21)[:, None]
    while thickness >= THINNEST:
        down = thickness * _down(strip)
        sides = [strip[0] + shares * down, strip[1] + shares * down, strip[0] + down + shares * (strip[1] - strip[0])]
        if all(z < max(terrain.height(x, 0.0), floor) + OUTSIDE for x, z in np.concatenate(sides)):
            break
        thickness /= 2
    return thickness


def _down(strip: Floats) -> Floats:
    """Unit vector (x, z) from a strip into the ground."""
    length, rise = strip[1] - strip[0]
    return np.asarray(np.array([rise, -length]) / np.hypot(length, rise))


def _add_strip(spec: Any, strip: Floats, thickness: float, settings: dict[str, Any]) -> None:
    """Adds a box whose upper face is a strip."""
    (length, rise), (x, z) = strip[1] - strip[0], strip.mean(axis=0) + thickness / 2 * _down(strip)
    turn = np.arctan2(rise, length)
    spec.worldbody.add_geom(
        type=mj.mjtGeom.mjGEOM_BOX,
        size=[np.hypot(length, rise) / 2, FLAT, thickness / 2],
        pos=[x, 0.0, z],
        quat=[np.cos(turn / 2), 0.0, -np.sin(turn / 2), 0.0],
        **settings,
    )


def _flat(terrain: Terrain) -> bool:
    return bool(terrain.to_dict()["shape"] == "flat")


def _settings(name: str, friction: float) -> dict[str, Any]:
    """Settings of a geom of the ground."""
    return {
        "name": name,
        "friction": [friction, 0.01, 0.001],
        "condim": 3,
        # The highest priority: the ground alone determines the contact parameters.
        "priority": 10,
        "contype": 1,
        "conaffinity": 0x7FFFFFFF,
        "material": NAME,
    }


def _add_heights(spec: Any, terrain: Terrain, feet: Floats, part: tuple[float, float], settings: dict[str, Any], patched: bool) -> None:
    """Adds a height field for the range ``part`` of x, m, which is between ends of patches if the ground is ``patched``."""
    low, high = feet.min((0, 1)) - MARGIN, feet.max((0, 1)) + MARGIN
    low[0], high[0] = part
    # The ends of patches are exact.
    xs = _even(low[0], high[0]) if patched else _samples(terrain, 0, low[0], high[0])
    ys = _samples(terrain, 1, low[1], high[1])
    (low[0], high[0]), (low[1], high[1]) = xs[[0, -1]], ys[[0, -1]]
    columns, rows = len(xs), len(ys)
    floor = float(feet[..., 2].min()) - DEPTH
    heights = np.array([[max(terrain.height(x, y), floor) for x in xs] for y in ys])
    bottom, top = float(heights.min()), float(heights.max())
    spread = max(top - bottom, 1e-3)
    name = settings["name"]
    spec.add_hfield(
        name=name,
        nrow=rows,
        ncol=columns,
        size=[(high[0] - low[0]) / 2, (high[1] - low[1]) / 2, spread, 0.5],
        userdata=((heights - bottom) / spread).ravel(),
    )
    center = (low + high) / 2
    spec.worldbody.add_geom(type=mj.mjtGeom.mjGEOM_HFIELD, hfieldname=name, pos=[center[0], center[1], bottom], **settings)


def _samples(terrain: Terrain, axis: int, low: float, high: float) -> Floats:
    """Coordinates along x or y, m, of the samples of a height field that covers the range from ``low`` to ``high``: those of a terrain that
    is a grid of heights, so that its edges are where the plan has them. Between them are others if they are more than CELL apart."""
    shape = terrain.to_dict()["shape"]
    if "grid" in shape:
        start, end = (float(shape["grid"][side][axis]) for side in ("low", "high"))
        cell = (end - start) / np.shape(shape["grid"]["heights"])[axis]
        cell /= np.ceil(cell / CELL - 1e-9)
        first, last = np.floor((low - start) / cell + 1e-9), np.ceil((high - start) / cell - 1e-9)
        if 2 <= last - first < SAMPLES:
            return start + cell * np.arange(first, last + 1)  # type: ignore[no-any-return]
    return _even(low, high)


def _even(low: float, high: float) -> Floats:
    """Coordinates from ``low`` to ``high``, m, at most CELL apart if that is possible."""
    return np.linspace(low, high, int(np.clip(np.ceil((high - low) / CELL), 2, SAMPLES - 1)) + 1)


def _light(spec: Any) -> None:
    """Adds a checkerboard of 0.2 m and a directional light for pictures."""
    spec.add_texture(
        name=NAME,
        type=mj.mjtTexture.mjTEXTURE_2D,
        builtin=mj.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.62, 0.66, 0.7],
        rgb2=[0.52, 0.56, 0.6],
        width=64,
        height=64,
    )
    material = spec.add_material(name=NAME, texrepeat=[2.5, 2.5], texuniform=True)
    material.textures[mj.mjtTextureRole.mjTEXROLE_RGB] = NAME
    # Without a GPU, shadows would take most of the rendering time.
    spec.worldbody.add_light(
        type=mj.mjtLightType.mjLIGHT_DIRECTIONAL, castshadow=False, pos=[0, 0, 4], dir=[0.3, 0.4, -1], diffuse=[0.7] * 3, ambient=[0.25] * 3
    )
