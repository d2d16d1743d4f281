"""Plays plans on robots in MuJoCo (``pip install cregopt[mujoco]``).

>>> import cregopt.mujoco
>>> robot = cregopt.mujoco.robot("go1.xml")
>>> gait = cregopt.search(cregopt.Task(robot, cregopt.Terrain("flat"), goal=(1.5, 0.0)))
>>> report = cregopt.mujoco.play(gait, "go1.xml")
>>> report.upright
True

``python -m cregopt.mujoco trajectory.json --model go1.xml`` does the last of these. A controller with 500 periods a second tracks base, feet and
forces of the plan by inverse dynamics of the whole body under the motors' torque limits; it knows the state. Units are SI, angles rad.
"""

from ._controller import Gains
from ._play import play
from ._report import Report
from ._robot import robot

__all__ = ["Gains", "Report", "play", "robot"]
