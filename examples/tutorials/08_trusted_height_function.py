# %% [markdown]
# # 8. A height function one can trust
#
# For two joints, the curvature of a connection is a *height function*: a gait around a hill moves
# the body by about the enclosed volume, −∬B. If the group does not commute, this is an
# approximation. Its quality depends on the frame on the body that is observed. The example is
# Purcell's swimmer, a robot dominated by drag.

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
# ## The exact displacement
# The phase is the exact displacement: this circle moves the swimmer by 0.0512808243 of its length.

# %%
p = pinred.phase(swimmer, circle)
displacement = float(np.hypot(*p.pose[:2]))
print(f"the circle moves it by {displacement:.10f}, known to {p.error.translation:.0e}")
np.testing.assert_allclose(displacement, 0.0512808243, atol=1e-9)

# %% [markdown]
# ## The approximation
# In the frame of the middle link the volume under the circle is off by a quarter; in the frame of
# the front link the error is of similar size.

# %%
for link in ("middle", "front"):
    field = swimmer if link == "middle" else swimmer.seen_from(link)
    print(f"{link:7} link: off by {100 * pinred.corrected_integral(field, circle).error:.1f} %")

# %% [markdown]
# ## A better frame
# The optimal frame is the one that gaits disturb least: among all frames h(x) on the body it
# minimises the mean square of A′. The result does not depend on the link from which one starts.

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
optimal = pinred.corrected_integral(swimmer, circle, best)
print(f"in it, the volume is off by {100 * optimal.error:.2f} %; trusted: {optimal.trusted}")
np.testing.assert_array_less(optimal.error, 0.005)

# %% [markdown]
# ## Where the approximation fails
# Larger gaits leave the region in which the approximation is good. The phase is exact everywhere.

# %%
wide = pinred.optimal_frame(swimmer, [(-2.5, 2.5), (-2.5, 2.5)])
for radius in (0.5, 1.0, 1.5, 2.0, 2.4):
    result = pinred.corrected_integral(swimmer, circle.scaled(radius), wide)
    print(f"radius {radius:.1f}: off by {100 * result.error:5.1f} %; trusted: {result.trusted}")

# %%
pinred.plot(swimmer, "field", component="v1", gait=circle) if drawing else None
