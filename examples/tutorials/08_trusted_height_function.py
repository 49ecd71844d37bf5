# %% [markdown]
# # 8. A height function one can trust
#
# Over two joints, the curvature of a connection is a *height function*: a gait that goes round a
# hill of it should move the body by about its volume, −∬B. For a group that does not commute that
# is only a guess, and how good it is depends on which frame on the body one watches. Here is
# Purcell's swimmer, which lives where drag rules.

# %%
from importlib.util import find_spec

import numpy as np

import pinred

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
third = 1.0 / 3.0
rods = {
    name: pinred.Rod(third, across=2.0, along=1.0, centre=(at, 0.0, 0.0))
    for name, at in (("rear", -0.5 * third), ("middle", 0.0), ("front", 0.5 * third))
}
swimmer = pinred.Connection.viscous(pinred.load("purcell_swimmer"), rods)
circle = pinred.Gait.fourier([0.0, 0.0], [[1.0, 0.0]], [[0.0, 1.0]])

# %% [markdown]
# ## The truth
# The phase is what really happens: this circle carries the swimmer by 0.0512808243 of its length.

# %%
p = pinred.phase(swimmer, circle)
moved = float(np.hypot(*p.pose[:2]))
print(f"the circle moves it by {moved:.10f}, known to {p.error.translation:.0e}")
np.testing.assert_allclose(moved, 0.0512808243, atol=1e-9)

# %% [markdown]
# ## The guess
# In the frame of the middle link the volume under the circle is a quarter off; from the front link
# it is no better.

# %%
for link in ("middle", "front"):
    seen = swimmer if link == "middle" else swimmer.seen_from(link)
    print(f"{link:7} link: off by {100 * pinred.corrected_integral(seen, circle).error:.1f} %")

# %% [markdown]
# ## A better frame
# Between gaits the best frame is the one that they disturb least: among all h(x) on the body it
# makes the mean square of A′ least. From whichever link one starts, it is the same.

# %%
box = [(-1.5, 1.5), (-1.5, 1.5)]
frames = {link: pinred.optimal_frame(swimmer.seen_from(link), box) for link in ("middle", "front")}
for link, frame in frames.items():
    print(
        f"from the {link:6} link: turns {frame.angular_before:.6f} → {frame.angular:.9f}, "
        f"shifts {frame.linear_before:.6f} → {frame.linear:.9f}"
    )
np.testing.assert_allclose(frames["middle"].linear, frames["front"].linear, atol=1e-8)
best = pinred.optimal_frame(swimmer, box)
found = pinred.corrected_integral(swimmer, circle, best)
print(f"in it, the volume is off by {100 * found.error:.2f} %; trusted: {found.trusted}")
np.testing.assert_array_less(found.error, 0.005)

# %% [markdown]
# ## And where to stop
# Larger gaits leave the region in which the guess is good. The phase itself knows no such region.

# %%
wide = pinred.optimal_frame(swimmer, [(-2.5, 2.5), (-2.5, 2.5)])
for radius in (0.5, 1.0, 1.5, 2.0, 2.4):
    each = pinred.corrected_integral(swimmer, circle.scaled(radius), wide)
    print(f"radius {radius:.1f}: off by {100 * each.error:5.1f} %; trusted: {each.trusted}")

# %%
pinred.plot(swimmer, "field", component="v1", gait=circle) if drawing else None
