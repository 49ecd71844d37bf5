"""Linearised flows along motions, against finite differences, ABA and Mathieu's equation."""

from __future__ import annotations

import aba
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from scipy.special import mathieu_b

import pinred
from pinred.analysis.stability.linearised_flow import linearised_flow
from pinred.common.arrays import Array
from pinred.forces import Controller, Damper
from pinred.reduction.canonical_form import CanonicalForm
from pinred.reduction.potential import Potential

SIX = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))  # offsets and weights of sixth-order differences


def chaotic_motion(duration: float) -> pinred.Trajectory:
    """A double spherical pendulum with enough energy for chaotic motion."""
    return pinred.simulate(
        pinred.load("double_spherical_pendulum"),
        x0=[2.0, 0.3, 1.0], xdot0=[0.0, 1.0, 0.0], xi0=[1.0], duration=duration,
    )  # fmt: skip


@pytest.mark.by_hand
def test_linearise_equals_differences_of_pinocchio_equations() -> None:
    """∂(ẋ, π̇)/∂(x, π) equals differences of Pinocchio's equations at a time inside the motion."""
    traj = chaotic_motion(2.0)
    system, t = traj.system, 1.3
    linear = pinred.linearise(traj, t)
    assert linear.names == (*system.shape_names, *(f"π {n}" for n in system.shape_names))
    form, mu = CanonicalForm(system, Potential(system)), traj.body_momentum[0]
    state = traj(t)
    H = pinred.Reduction(system).mass_matrix(state.x)
    z = np.concatenate([state.x, (H @ np.r_[state.xi, state.xdot])[1:]])
    np.testing.assert_allclose(linear.state, z, atol=1e-12)

    def rate(z: Array) -> Array:
        v = form.velocity(z[:3], np.concatenate([mu, z[3:]]))
        return np.concatenate([v[1:], form.force(z[:3], v)])

    h = 1e-3
    columns = [
        sum(w / h * (rate(z + n * h * e) - rate(z - n * h * e)) for n, w in SIX) for e in np.eye(6)
    ]
    np.testing.assert_allclose(linear.matrix, np.array(columns).T, atol=1e-7)
    values = linear.eigenvalues
    assert abs(values.sum()) < 1e-11
    assert "frequency" in str(linear)


@pytest.mark.by_hand
def test_linearise_includes_dampers_and_time_dependent_forces() -> None:
    """A damper adds −c Σ M⁻¹_kk to the trace; prescribed joints enter by the clock."""
    cat = pinred.load("falling_cat")
    c = 0.3
    traj = pinred.simulate(
        cat, duration=1.0, seed=2, forces=Damper("bend", c), prescribed={"sway": "0.3*sin(t)"}
    )
    linear = pinred.linearise(traj, 0.6)
    x = traj(0.6).x
    H = pinred.Reduction(cat).mass_matrix(x)
    rows = [0, 1, 2, 3, 4, 5, 6 + cat.shape_names.index("bend"), 6 + cat.shape_names.index("twist")]
    inverse = np.linalg.inv(H[np.ix_(rows, rows)])
    assert np.trace(linear.matrix) == pytest.approx(-c * inverse[6, 6], rel=1e-9)
    with pytest.raises(pinred.InputError, match="between 0 and 1"):
        pinred.linearise(traj, 2.0)
    shape = pinred.simulate(cat, duration=0.5, outputs="shape")
    with pytest.raises(pinred.InputError, match="outputs='all'"):
        pinred.linearise(shape, 0.1)


# Multipliers of Mathieu's equation check tangent directions by default.
@pytest.mark.by_hand
def test_tangent_directions_match_separation_of_aba_motions() -> None:
    """A tangent direction after 3 s equals the difference of two ABA runs."""
    traj = chaotic_motion(3.0)
    system, model = traj.system, traj.system.model
    flow = linearised_flow(traj)
    perturbation = np.array([0.3, -0.5, 0.2])  # change of the shape at constant momenta
    flow.Y[:] = 0.0
    flow.Y[:3, 0] = perturbation
    flow.advance(3.0)
    ends = []
    red = pinred.Reduction(system)
    momenta = red.mass_matrix(traj.x[0]) @ np.r_[traj.xi[0], traj.xdot[0]]
    for sign in (1.0, -1.0):
        x = traj.x[0] + sign * 1e-7 * perturbation
        v = np.linalg.solve(red.mass_matrix(x), momenta)
        q, rates = aba.integrate(model, system.q([0.0], x), v, np.array([3.0]), rtol=1e-13)
        end = system.configuration(q[-1])
        pi = (red.mass_matrix(end.x) @ rates[-1])[1:]
        ends.append(np.concatenate([end.x, pi]))
    difference = ends[0] - ends[1]
    difference[:3] -= 2.0 * np.pi * np.round(difference[:3] / (2.0 * np.pi))
    grown = difference / 2e-7
    size = np.abs(grown).max()
    assert size > 30.0
    np.testing.assert_allclose(flow.Y[:6, 0], grown, atol=1e-4 * size)


@pytest.mark.slow
def test_lyapunov_spectrum_is_paired_and_matches_aba() -> None:
    """The sum is zero to 1e-8, pairs agree to 2 %, and the largest exponent matches ABA to 10 %."""
    traj = chaotic_motion(20.0)
    spectrum = pinred.lyapunov(traj)
    assert len(spectrum.exponents) == 6
    assert abs(spectrum.exponents.sum()) < 1e-8
    largest = spectrum.exponents[0]
    assert np.abs(spectrum.exponents + spectrum.exponents[::-1]).max() < 0.02 * largest
    assert spectrum.history.shape == (len(spectrum.times), 6)
    assert "1/s" in str(spectrum)
    assert growth_rate_by_aba(traj, 20.0) == pytest.approx(largest, rel=0.1)


def growth_rate_by_aba(traj: pinred.Trajectory, end: float, every: float = 0.5) -> float:
    """Benettin's growth rate of the distance between two full motions by ABA, with rescaling."""
    system, model = traj.system, traj.system.model
    red, mu = pinred.Reduction(system), traj.body_momentum[0]
    q, v = traj.q[0], traj.v[0]
    apart, total, rng = 1e-7, 0.0, np.random.default_rng(1)
    state = np.concatenate([system.configuration(q).x, (red.mass_matrix(traj.x[0]) @ v)[1:]])
    other = state + apart * unit(rng.normal(size=6))

    def after(z: Array) -> Array:
        v = np.linalg.solve(red.mass_matrix(z[:3]), np.concatenate([mu, z[3:]]))
        q = system.q([0.0], z[:3])
        turned, rates = aba.integrate(model, q, v, np.array([every]), rtol=1e-10)
        x = system.configuration(turned[-1]).x
        x = z[:3] + np.remainder(x - z[:3] + np.pi, 2.0 * np.pi) - np.pi
        return np.concatenate([x, (red.mass_matrix(x) @ rates[-1])[1:]])

    for _ in range(round(end / every)):
        state, other = after(state), after(other)
        gone = other - state
        gone[:3] -= 2.0 * np.pi * np.round(gone[:3] / (2.0 * np.pi))
        total += np.log(np.linalg.norm(gone) / apart)
        other = state + apart * unit(gone)
    return float(total / end)


def unit(z: Array) -> Array:
    """Return the unit vector along z."""
    return np.asarray(z / np.linalg.norm(z))


def test_lyapunov_exponents_of_regular_motion_vanish() -> None:
    """Perturbations of Euler's top grow linearly in time, so exponents are of order log t/t."""
    body = pinred.load("rigid_body")
    spectrum = pinred.lyapunov(pinred.simulate(body, xi0=[0.5, 0.7, 1.6], duration=400.0))
    assert len(spectrum.exponents) == 2
    assert np.abs(spectrum.exponents).max() < 3.0 * np.log(400.0) / 400.0
    assert abs(spectrum.exponents.sum()) < 1e-9


HUB, MASS, LENGTH, WIDE, G = 0.3, 1.2, 0.7, 0.06, 9.81
INERTIA, PULL = MASS * LENGTH**2 + WIDE, MASS * LENGTH


def shaken_pendulum() -> pinred.System:
    """A pendulum on a hinge that slides up and down a hub."""
    model = pin.Model()
    model.name = "shaken"
    hub = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hub")
    model.appendBodyToJoint(hub, pin.Inertia(1.0, np.zeros(3), HUB * np.eye(3)), pin.SE3.Identity())
    lift = model.addJoint(hub, pin.JointModelPZ(), pin.SE3.Identity(), "lift")
    model.appendBodyToJoint(
        lift, pin.Inertia(0.5, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity()
    )
    arm = model.addJoint(lift, pin.JointModelRY(), pin.SE3.Identity(), "tilt")
    body = pin.Inertia(MASS, np.array([0.0, 0.0, -LENGTH]), np.diag([WIDE, WIDE, 0.01]))
    model.appendBodyToJoint(arm, body, pin.SE3.Identity())
    return pinred.load(model)


def shaken_motion(height: float, frequency: float, at: float) -> pinred.Trajectory:
    """The pendulum at rest at angle 0 or π, with an oscillating hinge, for one period."""
    return pinred.simulate(
        shaken_pendulum(), x0={"tilt": at}, duration=2.0 * np.pi / frequency, momentum=0,
        prescribed={"lift": f"{height!r}*cos({frequency!r}*t)"},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("height", "frequency", "at"), [(0.05, 9.0, 0.0), (0.2, 8.0, 0.0), (0.1, 90.0, np.pi)]
)
def test_floquet_multipliers_match_mathieu_equation(
    height: float, frequency: float, at: float
) -> None:
    """θ̈ ± (m l/I)(g − a ω² cos ωt) θ = 0, integrated by SciPy, gives the same multipliers."""
    multipliers = pinred.floquet(shaken_motion(height, frequency, at))
    sign = 1.0 if at == 0.0 else -1.0

    def hill(t: float, y: Array) -> list[float]:
        lift = G - height * frequency**2 * np.cos(frequency * t)
        return [y[1], -sign * PULL / INERTIA * lift * y[0]]

    T = 2.0 * np.pi / frequency
    columns = [
        solve_ivp(hill, (0.0, T), e, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
        for e in np.eye(2)
    ]
    expected = np.linalg.eigvals(np.array(columns).T).astype(complex)
    expected = expected[np.argsort(-np.abs(expected), kind="stable")]
    np.testing.assert_allclose(np.abs(multipliers.multipliers), np.abs(expected), rtol=1e-9)
    assert multipliers.multipliers.sum() == pytest.approx(expected.sum(), rel=1e-9)
    assert multipliers.multipliers.prod() == pytest.approx(1.0, abs=1e-11)
    if at:
        assert np.abs(multipliers.multipliers).max() == pytest.approx(
            1.0, abs=1e-9
        )  # stable as Kapitza's pendulum
    assert "closes to" in str(multipliers)


def test_floquet_multipliers_at_edge_of_mathieu_tongue_are_minus_one() -> None:
    """On a = b₁(q) both multipliers are −1."""
    frequency = 9.0
    q = -0.3
    # With τ = ωt/2: a = 4 m l g/(I ω²), q = 2 m l A/I. The sign of q is a shift of time.
    height = 2.0 * abs(q) * INERTIA / (4.0 * PULL)
    a = float(mathieu_b(1, abs(q)))
    frequency = float(np.sqrt(4.0 * PULL * G / (INERTIA * a)))
    multipliers = pinred.floquet(shaken_motion(height, frequency, 0.0))
    assert multipliers.multipliers.sum().real == pytest.approx(-2.0, abs=1e-9)


def time_of_closure(traj: pinred.Trajectory, closure: float) -> float:
    """Return the time in which a body's momentum changes by a given relative closure."""
    mu = traj.body_momentum[0]
    rate = np.abs(traj.system.group.coadjoint(traj.xi[0], mu)).max()
    return float(closure * (1.0 + np.abs(mu).max()) / rate)


def test_floquet_of_rigid_body_rotation() -> None:
    """A full period of Euler's top has multipliers 1; half a period is refused."""
    body, xi = pinred.load("rigid_body"), [0.5, 0.0, 1.6]
    traj = pinred.simulate(body, xi0=xi, duration=40.0)
    mu = traj.body_momentum
    # The period of the body momentum is the time between two upward zeros of L₂.
    from scipy.optimize import brentq

    up = np.flatnonzero((mu[:-1, 1] < 0.0) & (mu[1:, 1] >= 0.0))

    def crossing(k: int) -> float:
        return float(
            brentq(lambda t: traj(t).body_momentum[1], traj.t[k], traj.t[k + 1], xtol=1e-14)
        )

    T = crossing(int(up[1])) - crossing(int(up[0]))
    multipliers = pinred.floquet(traj, period=T)
    # The double eigenvalue 1 has a Jordan block, so its error is the root of round-off.
    np.testing.assert_allclose(multipliers.multipliers, 1.0, atol=1e-4)
    assert np.trace(multipliers.monodromy) == pytest.approx(2.0, abs=1e-8)
    for period in (0.5 * T, T + time_of_closure(traj, 4e-6)):
        with pytest.raises(pinred.InputError, match="differs from the initial one"):
            pinred.floquet(traj, period=period)
    assert pinred.floquet(traj, period=T + time_of_closure(traj, 4e-7)).closure == pytest.approx(
        4e-7, rel=0.1
    )
    with pytest.raises(pinred.InputError, match="at most the duration"):
        pinred.floquet(traj, period=50.0)


def test_motions_without_smooth_compiled_flow_are_refused() -> None:
    """The readable engine and discontinuous forces are refused."""
    cat = pinred.load("falling_cat")
    slow = pinred.simulate(cat, duration=0.1, engine="pinocchio")
    with pytest.raises(pinred.InputError, match="engine='compiled'"):
        pinred.lyapunov(slow)
    held = pinred.simulate(
        cat, duration=0.1, forces=Controller(lambda *_: {"bend": 0.0}, period=0.02)
    )
    with pytest.raises(pinred.InputError, match="smooth in time"):
        pinred.lyapunov(held)
    with pytest.raises(pinred.InputError, match="cannot be perturbed"):
        pinred.lyapunov(pinred.simulate(pinred.load("elroys_beanie"), duration=0.1))
