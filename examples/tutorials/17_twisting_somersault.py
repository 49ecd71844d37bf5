# %% [markdown]
# # 17. The twisting somersault
#
# A diver leaves the platform with both arms overhead and somersaults about the axis from left to
# right, without a twist. Then one arm swings down in a quarter of a second. The body tilts, the
# angular momentum L leaves the principal axis, and the body twists. When the arm swings up again at
# the right moment, the twist ends. Nothing acts from outside.
#
# The theory is that of Dullin and Tong ("Twisting somersault", SIAM J. Appl. Dyn. Syst. 15, 2016;
# "A new twisting somersault: 513XD", J. Nonlinear Sci. 27, 2017). The diver is our own. The numbers
# m of somersaults and n of twists follow from the loop that L draws on its sphere, as the body sees
# it.

# %%
from typing import Any

import numpy as np
from scipy.integrate import simpson, solve_ivp
from scipy.spatial.transform import Rotation

import pinred
from pinred.signals import Attitude, Spline

SWING, L = 0.25, 130.0  # duration of a swing [s]; angular momentum [kg m²/s]
UP, DOWN = [np.pi, 0.0, 0.0], [0.0, 0.0, 0.0]  # rotation vectors of a shoulder
diver = pinred.load("diver")
red = pinred.Reduction(diver)


def at_arm(angle: float) -> tuple[Any, Any]:
    """Return inertia about the centre of mass, and A of the left arm, (3, 3), at its angle."""
    arms = [0.0, 0.0, 0.0, angle, 0.0, 0.0, *UP]
    split = red.split(diver.space.integrate(diver.space.neutral, np.array(arms)))
    I = split.locked_inertia
    about_com = I[3:, 3:] - I[3:, :3] @ np.linalg.solve(I[:3, :3], I[:3, 3:])
    return about_com, split.local_connection[3:, 3:6]


# %% [markdown]
# ## The kick model
# If the swing takes no time, L does not act during it, and the body turns by −A dx. The sum of
# these turns is the tilt. From then on, the diver is a rigid body. Montgomery's formula 2ET/L − Λ
# gives the rotation about L in one twist, and complete elliptic integrals give both terms.

# %%
angles = np.linspace(np.pi, 0.0, 501)
tilt = float(simpson([-at_arm(angle)[1][0, 0] for angle in angles], angles))
rigid = pinred.load("diver", lock={"hips": DOWN, "left_shoulder": DOWN, "right_shoulder": UP})
seen = Rotation.from_rotvec([-tilt, 0.0, 0.0]).apply([0.0, L, 0.0])  # L in the tilted body
kick = pinred.rigid_body_phase(rigid, np.linalg.solve(at_arm(0.0)[0], seen))
print(f"the kick tilts the body by {np.degrees(tilt):.3f} degrees;", end=" ")
print(f"a twist takes {kick.period:.5f} s and {kick.angle / (2.0 * np.pi):.5f} somersaults")


# %% [markdown]
# ## The swing
# A swing takes time, so the shoulder is prescribed: R(t) = R_up exp(w(t)).


# %%
def dive(before: float, twisting: float, **options: Any) -> pinred.Trajectory:
    """Simulate a dive: somersault, arm down, twist, arm up, somersault; stages in seconds."""
    swings = [before, before + SWING + twisting]
    end = swings[1] + SWING + before
    fine = np.concatenate([np.linspace(-0.05, SWING + 0.05, 57) + start for start in swings])
    knots = np.unique(np.clip([0.0, *fine, end], 0.0, end))
    knots = knots[np.append(np.diff(knots) > 1e-6, True)]
    u = [np.clip((knots - start) / SWING, 0.0, 1.0) for start in swings]
    down, up = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2) for s in u)
    arm = Attitude([Spline(knots, np.pi * (up - down), end="clamped"), 0, 0], centre=UP)
    plan = {"hips": Attitude(DOWN), "left_shoulder": arm, "right_shoulder": Attitude(UP)}
    momentum = [0.0, 0.0, 0.0, 0.0, L, 0.0]
    return pinred.simulate(diver, prescribed=plan, momentum=momentum, duration=end, **options)


# %% [markdown]
# Time reversal with L_x → −L_x maps the equations to themselves. If L_x = 0 half way, the second
# half mirrors the first, and L ends where it began, on the principal axis. An event finds these
# moments: e_x · Rᵀ e_y = 2 (q_x q_y + q_z q_w). The n-th one after the swing belongs to n twists.

# %%
half = pinred.Event(lambda s: s.pose[3] * s.pose[4] + s.pose[5] * s.pose[6], "L_x = 0")
trial = dive(0.0, 2.0, events=[half])
moments = [t for t in trial.events["L_x = 0"].t if SWING < t < 1.5]
state = trial(moments[0])
twist = pinred.rigid_body_phase(rigid, state.xi[3:])
measured = moments[2] - moments[0]
print(f"after the swing, a twist takes {measured:.6f} s; by elliptic integrals {twist.period:.6f} s")
np.testing.assert_allclose(measured, twist.period, rtol=1e-6)

# %% [markdown]
# ## The dives
# The stages before and after the twist add somersaults at the rate L / I_yy. Choose their duration
# such that the diver enters the water head first, after a whole number and a half. In the code of
# dives, 5132 is a forward dive with three half somersaults and two half twists.

# %%
rate = L / at_arm(np.pi)[0][1, 1]
dives = []
for n, moment in enumerate(moments[:4], start=1):
    twisting = 2.0 * (moment - SWING)
    turned = Rotation.from_quat(dive(0.0, twisting).pose[-1, 3:]).as_rotvec()
    missing = (np.pi - turned[1]) % (2.0 * np.pi)
    dives.append(dive(missing / (2.0 * rate), twisting))
    final = Rotation.from_quat(dives[-1].pose[-1, 3:]).as_rotvec()
    np.testing.assert_allclose(np.abs(final), [0.0, np.pi, 0.0], atol=1e-6)

# %% [markdown]
# ## The master formula
# The angle of the somersault is φ = ∫ L·ω/|L| dt − Λ, also while the shape changes. Λ is the solid
# angle of the loop of L in the body. L follows from Euler's equation with the inertia I(t) and the
# momentum of the arm, L̇ = L × ω and ω = I⁻¹L − A ẋ: three numbers, no attitude, another integrator.

# %%
for n, traj in enumerate(dives, start=1):
    T, arm = float(traj.t[-1]), traj.scene.prescribed["left_shoulder"]

    def slope(t: float, y: Any, arm: Any = arm) -> Any:
        I, A = at_arm(np.pi + float(arm.vector[0].value(t)))
        omega = np.linalg.solve(I, y[:3]) - A @ arm.rate(t)
        return np.append(np.cross(y[:3], omega), y[:3] @ omega / L)

    t = np.linspace(0.0, T, 4001)
    motion = solve_ivp(slope, (0.0, T), [0.0, L, 0.0, 0.0], "DOP853", t, rtol=1e-8, atol=1e-8)
    ell, dynamic = motion.y[:3] / L, motion.y[3, -1]
    twists = np.unwrap(np.arctan2(ell[0], ell[1]))
    solid = simpson(ell[2] * np.gradient(twists, t, edge_order=2), t)
    m = (dynamic - solid) / (2.0 * np.pi)
    print(f"51{round(2.0 * m)}{2 * n}: {T:.4f} s, {m:.6f} somersaults,", end=" ")
    print(f"{abs(twists[-1]) / (2.0 * np.pi):.6f} twists by the formula")
    np.testing.assert_allclose(m % 1.0, 0.5, atol=1e-5)
    np.testing.assert_allclose(twists[-1], -2.0 * np.pi * n, atol=1e-4)

# %% [markdown]
# ABA, which knows nothing of the reduction, confirms the dive of two twists.

# %%
report = pinred.compare(dives[1])
print(report)
assert report.passed
