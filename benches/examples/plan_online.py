"""Planning online: 50 updates a second from a measured state, and references for a controller at 500 Hz."""

import cregopt
import numpy as np


def measured(at: cregopt.Samples, i: int) -> cregopt.RobotState:
    """State of a robot that follows its plan exactly. A real robot measures it."""
    cross = np.cross(np.eye(3), at.base_quaternion[i, 1:])
    rotation = np.eye(3) + 2 * at.base_quaternion[i, 0] * cross + 2 * cross @ cross
    base = at.base_position[i], rotation, at.base_velocity[i], at.base_angular_velocity[i]
    return cregopt.RobotState(*base, at.feet_position[i], at.feet_velocity[i], at.contacts[i])


robot, terrain = cregopt.Robot("anymal"), cregopt.Terrain("flat")
planner = cregopt.Planner(robot, terrain, {"latency": 0.02, "candidates": 8})
base, zero = np.array([0.0, 0.0, -robot.nominal_feet[0, 2]]), np.zeros(3)
feet = base + robot.nominal_feet
state = cregopt.RobotState(base, np.eye(3), zero, zero, feet, 0 * feet, [True] * robot.feet)
gaits: list[object] = []
seconds = []
for tick in range(1, 76):
    update = planner.update(state, (0.5, 0.0, 0.2), now=(tick - 1) / 50)
    plan = update.plan
    seconds.append(update.seconds)
    gaits += [] if gaits[-1:] == [plan.gait] else [plan.gait]
    reference = plan.sample(rate=500)  # entered at the time since the start of the plan
    index = max(round((tick / 50 - plan.start) * 500), 0)
    state = measured(reference, index)
print(f"gaits {gaits}, {1e3 * np.median(seconds):.0f} ms per update in the median")
print(f"after {tick / 50:.1f} s at {reference.base_position[index].round(2)} m")
assert reference.base_position[index, 0] > 0.3
