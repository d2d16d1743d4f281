"""MuJoCo and the solver of quadratic programs, which are imported at their first use."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Late:
    """A module that is imported when something of it is asked for."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        try:
            module = importlib.import_module(self._name)
        except ImportError as error:
            raise ImportError(f"cregopt.mujoco needs {self._name}, which is not there ({error}): pip install cregopt[mujoco]") from error
        self.__dict__.update(vars(module))
        return getattr(module, attribute)


# Neither has types of its own.
mj: Any = Late("mujoco")
daqp: Any = Late("daqp")
