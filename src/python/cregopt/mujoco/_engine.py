"""MuJoCo and the quadratic programming solver DAQP, imported at their first use."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Late:
    """Module that is imported when one of its attributes is first used."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        try:
            module = importlib.import_module(self._name)
        except ImportError as error:
            raise ImportError(f"cregopt.mujoco needs {self._name}, which cannot be imported ({error}): pip install cregopt[mujoco]") from error
        self.__dict__.update(vars(module))
        return getattr(module, attribute)


# Neither package has type stubs.
mj: Any = Late("mujoco")
daqp: Any = Late("daqp")
