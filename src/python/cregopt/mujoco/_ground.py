"""Terrain of a plan as MuJoCo geometry."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import Terrain
from ._engine import Floats, mj

#: Name of the ground's geom, which no model uses.
NAME = "cregopt ground"
#: Distance between height samples of uneven ground, m. A larger distance rounds off edges.
CELL = 0.02
#: Width of ground around the planned positions of the feet, m.
MARGIN = 1.0
#: Largest number of height samples along one side.
SAMPLES = 1000
#: Depth below the lowest planned foot position at which the ground is cut off, m.
DEPTH = 1.0


def add(spec: Any, terrain: Terrain, friction: float, feet: Floats) -> None:
    """Adds the ground to a model: a plane, or a height field around the foot positions ``feet``, shape (n, feet, 3), m."""
    settings: dict[str, Any] = {
        "name": NAME,
        "friction": [friction, 0.01, 0.001],
        "condim": 3,
        # The highest priority: the ground alone determines the contact parameters.
        "priority": 10,
        "contype": 1,
        "conaffinity": 0x7FFFFFFF,
        "material": NAME,
    }
    _light(spec)
    if terrain.to_dict()["shape"] == "flat":
        spec.worldbody.add_geom(type=mj.mjtGeom.mjGEOM_PLANE, size=[50.0, 50.0, 0.1], **settings)
        return
    low, high = feet.min((0, 1)) - MARGIN, feet.max((0, 1)) + MARGIN
    columns, rows = (int(np.clip(np.ceil(length / CELL), 2, SAMPLES - 1)) + 1 for length in (high - low)[:2])
    xs, ys = np.linspace(low[0], high[0], columns), np.linspace(low[1], high[1], rows)
    floor = float(feet[..., 2].min()) - DEPTH
    heights = np.array([[max(terrain.height(x, y), floor) for x in xs] for y in ys])
    bottom, top = float(heights.min()), float(heights.max())
    spread = max(top - bottom, 1e-3)
    spec.add_hfield(
        name=NAME,
        nrow=rows,
        ncol=columns,
        size=[(high[0] - low[0]) / 2, (high[1] - low[1]) / 2, spread, 0.5],
        userdata=((heights - bottom) / spread).ravel(),
    )
    center = (low + high) / 2
    spec.worldbody.add_geom(type=mj.mjtGeom.mjGEOM_HFIELD, hfieldname=NAME, pos=[center[0], center[1], bottom], **settings)


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
