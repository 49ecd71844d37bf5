"""A falling cat rotates without angular momentum: springs in its spine bend and twist it."""

import numpy as np

import pinred

cat = pinred.load("falling_cat")
springs = dict.fromkeys(cat.shape_names, (2.0, 0.0))
x0 = np.linspace(0.9, -0.6, cat.m)
traj = pinred.simulate(cat, x0=x0, momentum=0, duration=2.0, springs=springs)

rotation = cat.group.error(traj.pose[:1], traj.pose).rotation
print(f"largest rotation of the front half: {np.degrees(rotation.max()):.1f} deg")
print(f"momentum never exceeds {np.abs(traj.body_momentum).max():.1e}")
print(pinred.compare(traj))
