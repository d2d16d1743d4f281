"""Animations of simulations."""

from __future__ import annotations

import ctypes.util
import os
import pathlib
import sys
from types import TracebackType
from typing import Any, Optional

from .. import Error
from ._engine import Late, mj
from ._model import Path

#: Frames per second. The size of a frame in pixels follows.
RATE = 25
WIDTH, HEIGHT = 480, 320
#: Quality of WebP, 0 to 100, and MuJoCo's scale of the lengths of arrows.
QUALITY, ARROW = 40, 0.015
#: Suffixes of the supported animation formats.
KINDS = (".gif", ".png", ".apng", ".webp")

_images: Any = Late("PIL.Image")


def headless() -> bool:
    """True if there is no display."""
    return sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def prepare(path: Path) -> None:
    """Prepares rendering to a file. Raises Error for another suffix.

    Without a display it selects off-screen rendering, which has an effect only before MuJoCo is imported.
    """
    if pathlib.Path(path).suffix.lower() not in KINDS:
        raise Error(f"{os.fspath(path)}: an animation is one of {', '.join(KINDS)}")
    if headless() and "MUJOCO_GL" not in os.environ and "mujoco" not in sys.modules:
        # With MUJOCO_GL set to a missing library, the import of MuJoCo fails.
        found = [name for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)]
        if not found:
            raise Error("no pictures can be drawn without a display: neither EGL nor OSMesa is installed (Debian: libegl1, libosmesa6)")
        os.environ["MUJOCO_GL"] = found[0].lower()


class Film:
    """Records the frames of a simulation and writes the file at the end."""

    def __init__(self, path: Path, model: Any, base: int, distance: float, rate: float) -> None:
        self.path, self.every, self.periods = pathlib.Path(path), max(1, round(rate / RATE)), 0
        self.frames: list[Any] = []
        try:
            self.renderer = mj.Renderer(model, HEIGHT, WIDTH)
        except Exception as error:
            raise Error(f"no pictures can be drawn here: {error}; MUJOCO_GL=egl or MUJOCO_GL=osmesa draws without a display") from error
        self.camera = mj.MjvCamera()
        self.camera.type, self.camera.trackbodyid = mj.mjtCamera.mjCAMERA_TRACKING, base
        self.camera.distance, self.camera.azimuth, self.camera.elevation = distance, 60.0, -15.0
        # Pushes are arrows.
        model.vis.map.force = ARROW
        self.options = mj.MjvOption()
        self.options.flags[mj.mjtVisFlag.mjVIS_PERTFORCE] = True

    def __enter__(self) -> Film:
        return self

    def __call__(self, _: Any, data: Any) -> None:
        if self.periods % self.every == 0:
            self.renderer.update_scene(data, self.camera, self.options)
            self.frames.append(_images.fromarray(self.renderer.render()))
        self.periods += 1

    def __exit__(self, kind: Optional[type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]) -> None:
        self.renderer.close()
        if kind is None and self.frames:
            # The file appears under its name only when it is complete.
            part = self.path.with_name(f".{self.path.stem}.part{self.path.suffix}")
            try:
                # Other formats have no quality.
                self.frames[0].save(part, save_all=True, append_images=self.frames[1:], duration=1000 // RATE, loop=0, quality=QUALITY)
                part.replace(self.path)
            except OSError as failure:
                part.unlink(missing_ok=True)
                raise Error(f"{self.path}: {failure}") from failure
