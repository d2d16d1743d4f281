"""Simulation: plans for a MuJoCo model, and plays the plan with a whole-body controller.

    python benches/examples/play_in_mujoco.py MODEL.xml
"""

import sys

import cregopt
import cregopt.mujoco

model = sys.argv[1]
robot = cregopt.mujoco.robot(model)
gait = cregopt.search(cregopt.Task(robot, cregopt.Terrain("flat"), goal=(0.6, 0.0)), generations=1)
report = cregopt.mujoco.play(gait, model, seed=1)
print(report)
assert report.upright
