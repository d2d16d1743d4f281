"""Terrain of a plan as MuJoCo geometry."""

from __future__ import annotations

from typing import Any, Sequence

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
#: Colour of patches, by which that of the ground is multiplied.
TINT = [0.65, 0.8, 1.0, 1.0]

#: Part of the ground with its own friction coefficient: friction, and the range of x that it covers, m.
Patch = tuple[float, float, float]


def add(spec: Any, terrain: Terrain, friction: float, feet: Floats, patches: Sequence[Patch] = ()) -> list[str]:
    """Adds the ground to a model: a plane, or height fields around the foot positions ``feet``, shape (n, feet, 3), m.

    Returns the names of its geoms: one, and with patches one for each part between their ends. Patches do not overlap.
    """
    _light(spec)
    if not patches and _flat(terrain):
        spec.worldbody.add_geom(type=mj.mjtGeom.mjGEOM_PLANE, size=[FLAT, FLAT, 0.1], **_settings(NAME, friction))
        return [NAME]
    low, high = (-FLAT, FLAT) if _flat(terrain) else (float(feet[..., 0].min()) - MARGIN, float(feet[..., 0].max()) + MARGIN)
    ends = sorted({low, high, *(float(np.clip(end, low, high)) for _, *range in patches for end in range)})
    names = []
    for number, (start, end) in enumerate(zip(ends, ends[1:])):
        names.append(f"{NAME} {number}" if number else NAME)
        inside = [of for of, first, last in patches if first < (start + end) / 2 < last]
        settings = _settings(names[-1], *(inside or [friction]))
        if inside:
            settings["rgba"] = TINT
        if _flat(terrain):
            # The friction of a plane is the same everywhere.
            size, center = [(end - start) / 2, FLAT, DEPTH / 2], [(start + end) / 2, 0.0, -DEPTH / 2]
            spec.worldbody.add_geom(type=mj.mjtGeom.mjGEOM_BOX, size=size, pos=center, **settings)
        else:
            _add_heights(spec, terrain, feet, (start, end), settings)
    return names


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


def _add_heights(spec: Any, terrain: Terrain, feet: Floats, part: tuple[float, float], settings: dict[str, Any]) -> None:
    """Adds a height field for the range ``part`` of x, m."""
    low, high = feet.min((0, 1)) - MARGIN, feet.max((0, 1)) + MARGIN
    low[0], high[0] = part
    columns, rows = (int(np.clip(np.ceil(length / CELL), 2, SAMPLES - 1)) + 1 for length in (high - low)[:2])
    xs, ys = np.linspace(low[0], high[0], columns), np.linspace(low[1], high[1], rows)
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
