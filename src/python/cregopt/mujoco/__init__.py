"""Plays plans on robots in MuJoCo (``pip install cregopt[mujoco]``).

>>> import cregopt.mujoco
>>> robot = cregopt.mujoco.robot("go1.xml")
>>> gait = cregopt.search(cregopt.Task(robot, cregopt.Terrain("flat"), goal=(1.5, 0.0)))
>>> report = cregopt.mujoco.play(gait, "go1.xml")
>>> report.upright
True

``python -m cregopt.mujoco trajectory.json --model go1.xml`` plays a plan from the command line. A controller at 500 Hz tracks the base, feet and
forces of the plan by whole-body inverse dynamics within the motors' torque limits. It knows the exact state. ``drive`` (on the command line
``python -m cregopt.mujoco drive``) follows commands instead of a plan, with gaits that are chosen online. Units are SI, angles are in rad.

``export`` (on the command line ``python -m cregopt.mujoco dataset``) writes the motions of ``cregopt dataset`` as references of a model, in the files
that mjlab and LocoMuJoCo read. ``play_dataset`` (with the option ``--play``) plays these motions.

Legs with six joints stand on soles (humanoids). Their legs are heavy and their ankles weak: plans with faster swings than the default
(the setting ``transcription.foot_acceleration``, 48 m/s² for Unitree's G1) can topple them.
"""

from ._controller import Gains
from ._dataset import Exported, Reference, export, play_dataset, reference
from ._drive import drive, random_drive
from ._play import play
from ._report import DriveReport, Report
from ._robot import robot

__all__ = ["DriveReport", "Exported", "Gains", "Reference", "Report", "drive", "export", "play", "play_dataset", "random_drive", "reference", "robot"]
