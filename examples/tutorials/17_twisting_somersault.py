# %% [markdown]
# # 17. The twisting somersault
#
# A diver leaves the platform with both arms overhead and somersaults about the axis from left to
# right, without a twist. Then one arm swings down in a quarter of a second. The body tilts, the
# angular momentum L leaves the principal axis, and the body twists. When the arm swings up again at
# the right moment, the twist ends. Nothing acts from outside. The theory is that of Dullin and Tong
# ("Twisting somersault", SIAM J. Appl. Dyn. Syst. 15, 2016; "A new twisting somersault: 513XD", J.
# Nonlinear Sci. 27, 2017); the diver is our own.

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
    arms = np.array([0.0, 0.0, 0.0, angle, 0.0, 0.0, *UP])
    split = red.split(diver.space.integrate(diver.space.neutral, arms))
    I = split.locked_inertia
    about_com = I[3:, 3:] - I[3:, :3] @ np.linalg.solve(I[:3, :3], I[:3, 3:])
    return about_com, split.local_connection[3:, 3:6]


# %% [markdown]
# ## The kick model
# If the swing takes no time, L does not act during it: the body turns by −A dx, and the sum is the
# tilt. From then on, the diver is a rigid body. Montgomery's formula 2ET/L − Λ gives the rotation
# about L in one twist; complete elliptic integrals give both terms.

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
# A swing takes time, so the attitude of the shoulder is prescribed, R(t) = R_up exp(w(t)).


# %%
def dive(before: float, twisting: float, **options: Any) -> pinred.Trajectory:
    """Simulate somersault, arm down, twist, arm up, somersault; durations in seconds."""
    swings = [before, before + SWING + twisting]
    end = swings[1] + SWING + before
    knots = np.concatenate([np.linspace(-0.05, SWING + 0.05, 57) + start for start in swings])
    knots = np.unique(np.clip([0.0, *knots, end], 0.0, end))
    knots = knots[np.append(np.diff(knots) > 1e-6, True)]
    u = [np.clip((knots - start) / SWING, 0.0, 1.0) for start in swings]
    down, up = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2) for s in u)
    arm = Attitude([Spline(knots, np.pi * (up - down), end="clamped"), 0, 0], centre=UP)
    plan = {"hips": Attitude(DOWN), "left_shoulder": arm, "right_shoulder": Attitude(UP)}
    momentum = [0.0, 0.0, 0.0, 0.0, L, 0.0]
    return pinred.simulate(diver, prescribed=plan, momentum=momentum, duration=end, **options)


# %% [markdown]
# Time reversal with L_x → −L_x maps the equations to themselves. If L_x = 0 half way, the second
# half mirrors the first, and L returns to the principal axis. An event finds these moments,
# e_x · Rᵀ e_y = 2 (q_x q_y + q_z q_w) = 0. The n-th one after the swing belongs to n twists.

# %%
half = pinred.Event(lambda s: s.pose[3] * s.pose[4] + s.pose[5] * s.pose[6], "L_x = 0")
trial = dive(0.0, 1.0, events=[half])
moments = [t for t in trial.events["L_x = 0"].t if SWING + 0.05 < t < SWING + 0.95][:3]
twist = pinred.rigid_body_phase(rigid, trial(moments[0]).xi[3:])
print(f"after the swing, a twist takes {moments[2] - moments[0]:.6f} s;", end=" ")
print(f"by elliptic integrals {twist.period:.6f} s")
np.testing.assert_allclose(moments[2] - moments[0], twist.period, rtol=1e-6)

# %% [markdown]
# ## The dives
# Before and after the twist, the diver somersaults at the rate L / I_yy; the duration of these
# stages decides about head or feet first. L also obeys Euler's equation of the changing body,
# L̇ = L × ω with ω = I⁻¹L − A ẋ: three numbers, no attitude, and here another integrator. The angle
# of the somersault is then φ = ∫ L·ω/|L| dt − Λ, with the solid angle Λ of the loop of L.

# %%
rate = L / at_arm(np.pi)[0][1, 1]
for n, moment in enumerate(moments, start=1):
    twisting = 2.0 * (moment - SWING)
    turned = Rotation.from_quat(dive(0.0, twisting).pose[-1, 3:]).as_rotvec()[1]
    traj = dive((np.pi - turned) % (2.0 * np.pi) / (2.0 * rate), twisting)
    end = Rotation.from_quat(traj.pose[-1, 3:]).as_rotvec()
    np.testing.assert_allclose(np.abs(end), [0.0, np.pi, 0.0], atol=1e-6)
    T, arm = float(traj.t[-1]), traj.scene.prescribed["left_shoulder"]

    def _slope(t: float, y: Any, arm: Any = arm) -> Any:
        I, A = at_arm(np.pi + float(arm.vector[0].value(t)))
        omega = np.linalg.solve(I, y[:3]) - A @ arm.rate(t)
        return np.append(np.cross(y[:3], omega), y[:3] @ omega / L)

    t = np.linspace(0.0, T, 2001)
    motion = solve_ivp(_slope, (0.0, T), [0.0, L, 0.0, 0.0], "DOP853", t, rtol=1e-8, atol=1e-8)
    twists = np.unwrap(np.arctan2(motion.y[0], motion.y[1]))
    solid_angle = simpson(motion.y[2] / L * np.gradient(twists, t, edge_order=2), t)
    somersaults = (motion.y[3, -1] - solid_angle) / (2.0 * np.pi)
    print(f"dive 51{round(2.0 * somersaults)}{2 * n}: {T:.4f} s, {somersaults:.6f} somersaults, "
          f"{abs(twists[-1]) / (2.0 * np.pi):.6f} twists")  # fmt: skip
    np.testing.assert_allclose([somersaults % 1.0, twists[-1]], [0.5, -2.0 * np.pi * n], atol=1e-4)

report = pinred.compare(traj)  # ABA knows nothing of the reduction
print(report)
assert report.passed
