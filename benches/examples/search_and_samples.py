"""Search: a gait, its cost, and its motion as NumPy arrays."""

import cregopt

task = cregopt.Task(cregopt.Robot("anymal"), cregopt.Terrain("flat"), goal=(1.5, 0.2), yaw=0.3)
gait = cregopt.search(task, seed=1, generations=1)
assert gait.feasible and gait.cost
print(gait.family, f"costs {gait.cost['total']:.3f} per weight and distance")

samples = gait.sample(rate=200)  # forces: N, (instants, feet, 3)
weight = 9.80665 * task.robot.mass
share = samples.forces[..., 2].sum(axis=1) / weight
print(f"{len(samples)} instants, total normal force {share.min():.2f} to {share.max():.2f} weights")
for name, contacts in zip(samples.feet_names, samples.contacts.T):
    print(name, "".join("#" if contact else "." for contact in contacts[::10]))
