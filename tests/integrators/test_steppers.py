"""The steppers against closed forms and SciPy: order, equal bits, failures, interruption."""

from __future__ import annotations

import pickle
import signal
import threading
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from orbits import kepler_orbit
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, erf
from stiff_kernels import kernel, kernel_by_numba

from pinred.common.arrays import Array
from pinred.common.errors import (
    InputError,
    IntegrationError,
    NonFiniteState,
    ShapeError,
    StepSizeUnderflow,
    TooManySteps,
)
from pinred.integrators import integrate as drive
from pinred.integrators import integrate_many as several
from pinred.integrators.integrate import Solution, integrate
from pinred.integrators.integrate_many import STATUS, integrate_many
from pinred.integrators.methods import DOP853, RKMK4, Explicit, Method, Tsit5
from pinred.integrators.methods import METHODS as ALL
from pinred.integrators.stepping import run_state


@kernel
def oscillator(y: Any, p: Any, d: Any) -> None:
    """ẋ = ω v, v̇ = −ω x."""
    d[0], d[1] = p[0] * y[1], -p[0] * y[0]


def counted(y: Any, p: Any, d: Any) -> None:
    """The oscillator, which counts its calls in its parameter."""
    p[0] += 1.0
    d[0], d[1] = y[1], -y[0]


@kernel
def power(y: Any, p: Any, d: Any) -> None:
    """ẏ = a y^k."""
    d[0] = p[0] * y[0] ** p[1]


@kernel
def kepler(y: Any, p: Any, d: Any) -> None:  # noqa: ARG001
    """Planar motion about a mass at the origin."""
    square = y[0] * y[0] + y[1] * y[1]
    force = 1.0 / (square * ca.sqrt(square))
    d[0], d[1], d[2], d[3] = y[2], y[3], -force * y[0], -force * y[1]


@kernel
def pulse(y: Any, p: Any, d: Any) -> None:
    """A clock, and a velocity that a short force changes at clock time one."""
    s = (y[0] - 1.0) / p[0]
    d[0], d[1] = 1.0, ca.exp(-s * s) / p[0]


@kernel
def edge(y: Any, p: Any, d: Any) -> None:  # noqa: ARG001
    """A rate that is not a number after clock time one half."""
    d[0], d[1], d[2] = 1.0, 0.0, ca.sqrt(0.5 - y[0])


def top_rate(y: Any, p: Any, d: Any) -> None:
    """A top: ω (3,), attitude (4,); params: inertias (3,), gravity force times CoM height."""
    a, b, c, x, s, z, w = y[0], y[1], y[2], y[3], y[4], y[5], y[6]
    square = x * x + s * s + z * z + w * w
    up_x, up_y = 2.0 * (x * z - s * w) / square, 2.0 * (s * z + x * w) / square
    d[0] = ((p[1] - p[2]) * b * c + p[3] * up_y) / p[0]
    d[1] = ((p[2] - p[0]) * c * a - p[3] * up_x) / p[1]
    d[2] = (p[0] - p[1]) * a * b / p[2]
    d[3], d[4] = 0.5 * (w * a + s * c - z * b), 0.5 * (w * b + z * a - x * c)
    d[5], d[6] = 0.5 * (w * c + x * b - s * a), 0.5 * (-x * a - s * b - z * c)


top = kernel(top_rate)
FREE, HEAVY = np.array([1.0, 2.0, 3.0, 0.0]), np.array([1.0, 2.0, 3.0, 2.0])
TOP0 = np.array([0.7, -0.4, 1.1, 0.1, 0.5, -0.3, 0.8])
TOP0[3:] /= np.linalg.norm(TOP0[3:])
TIGHT = DOP853(rtol=1e-13, atol=1e-14)


def top_by_scipy(params: Array, y0: Array, times: Array) -> Array:
    """Return the top's states (T, 7) by SciPy, with unit quaternions."""

    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        d = np.empty(7)
        top_rate(y, params, d)
        return d

    y = solve_ivp(rate, (0, times[-1]), y0, "DOP853", times, rtol=3e-14, atol=1e-15).y.T
    y[:, 3:] /= np.linalg.norm(y[:, 3:], axis=1, keepdims=True)
    return np.asarray(y)


def momentum(y: Array) -> Array:
    """Return the spatial momentum of free tops (T, 7), (T, 3)."""
    return np.asarray(Rotation.from_quat(y[:, 3:]).apply(FREE[:3] * y[:, :3]))


def order_of(steps: list[float], errors: list[float]) -> float:
    """Return the order by which errors fall with the step."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


EXPLICIT = [kind for kind in ALL.values() if issubclass(kind, Explicit)]


def fixed(kind: type[Explicit], step: float) -> Explicit:
    """A method with fixed steps, because the tolerance is never reached."""
    return kind(rtol=100.0, atol=100.0, max_step=step)


# --- accuracy ------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", EXPLICIT)
def test_explicit_methods_have_their_order(kind: type[Explicit]) -> None:
    """At the end of many equal steps."""
    t_end, steps, errors = 2.0 * np.pi, [], []
    start = kepler_orbit(0.1, np.zeros(1))[0]
    order = kind(1.0, 1.0).order
    for count in np.round(np.geomspace(25, 64, 5) * 10.0 ** max(0.0, 2.4 - 0.3 * order)):
        run = integrate(fixed(kind, t_end / count), kepler, [], start, t_end, [t_end])
        assert abs(run.steps - count) <= 1
        assert run.rejected == 0
        steps.append(t_end / count)
        errors.append(float(np.linalg.norm(run.y - kepler_orbit(0.1, run.times))))
    assert min(errors) > 1e-12
    assert order_of(steps, errors) == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize("kind", [*EXPLICIT, RKMK4])
def test_dense_output_has_its_order(kind: type[Explicit] | type[RKMK4]) -> None:
    """Within one step the error of a polynomial of order p falls with h^(p + 1)."""
    steps, errors = np.geomspace(0.15, 0.4, 6), []
    claimed = (kind(0.1) if kind is RKMK4 else kind(1.0, 1.0)).dense_order  # type: ignore[call-arg]
    for h in (steps * min(1.0, 2.0 ** (claimed - 6))).tolist():
        times = h * np.array([0.2, 0.4, 0.6, 0.8])
        method = fixed(kind, h) if issubclass(kind, Explicit) else kind(h)
        run = integrate(method, top, HEAVY, TOP0, h, times, (3, 1))
        assert run.steps == 1
        exact = top_by_scipy(HEAVY, TOP0, np.append(times, h))[:-1]
        errors.append(float(np.linalg.norm(run.y - exact)))
    assert order_of(list(steps), errors) == pytest.approx(claimed + 1, abs=0.2)


def test_rkmk4_has_order_4() -> None:
    """At step ends and inside steps, in velocity and attitude."""
    t_end = 3.0
    times = np.linspace(0.0, t_end, 38)
    exact = top_by_scipy(HEAVY, TOP0, times)
    steps = [t_end / count for count in (80, 120, 180, 270, 400)]
    runs = [integrate(RKMK4(step), top, HEAVY, TOP0, t_end, times, (3, 1)) for step in steps]
    for entries in (slice(0, 3), slice(3, 7)):
        for when in (slice(-1, None), slice(1, -1)):
            errors = [float(abs(run.y - exact)[when, entries].max()) for run in runs]
            assert order_of(steps, errors) == pytest.approx(RKMK4.order, abs=0.2)


def test_rkmk4_momentum_has_order_4_by_correction() -> None:
    """Without dexp⁻¹ the momentum's error would have order 2."""
    t_end = 2.0

    def plain(count: int) -> Array:
        h, y = t_end / count, TOP0.copy()

        def rate(y: Array) -> Array:
            d = np.empty(7)
            top_rate(y, FREE, d)
            return np.append(d[:3], y[:3])

        def move(k: Array, h: float) -> Array:
            rotation = Rotation.from_quat(y[3:]) * Rotation.from_rotvec(h * k[3:])
            return np.append(y[:3] + h * k[:3], rotation.as_quat())

        for _ in range(count):
            k1 = rate(y)
            k2 = rate(move(k1, h / 2))
            k3 = rate(move(k2, h / 2))
            k4 = rate(move(k3, h))
            y = move((k1 + 2 * k2 + 2 * k3 + k4) / 6, h)
        return y[None]

    counts, start = (40, 60, 90, 135), momentum(TOP0[None])
    steps = [t_end / count for count in counts]
    ours = [integrate(RKMK4(h), top, FREE, TOP0, t_end, [t_end], (3, 1)).y for h in steps]
    drift = [float(np.linalg.norm(momentum(y) - start)) for y in ours]
    naive = [float(np.linalg.norm(momentum(plain(count)) - start)) for count in counts]
    assert order_of(steps, drift) == pytest.approx(4.0, abs=0.2)
    assert order_of(steps, naive) == pytest.approx(2.0, abs=0.2)
    assert max(drift) < 1e-2 * min(naive)


@pytest.mark.parametrize(
    ("method", "bound"), [(TIGHT, 2e-12), (Tsit5(1e-12, 1e-14), 1e-9), (RKMK4(1e-3), 1e-10)]
)
def test_free_top_equals_closed_form(method: Method, bound: float) -> None:
    """ω by Jacobi's elliptic functions, the attitude by the constant spatial momentum."""
    I1, I2, I3 = FREE[:3]
    a = np.array([0.4, 0.0, 1.2])  # ω at the start, on the cn and dn axes
    E2, L2 = a**2 @ FREE[:3], a**2 @ FREE[:3] ** 2
    t = np.linspace(0.0, 20.0, 41)
    nu = np.sqrt((I3 - I2) * (L2 - E2 * I1) / (I1 * I2 * I3))
    k2 = (I2 - I1) * (E2 * I3 - L2) / ((I3 - I2) * (L2 - E2 * I1))
    sn, cn, dn, _ = ellipj(nu * t, k2)
    b = np.sqrt((E2 * I3 - L2) / (I2 * (I3 - I2)))
    exact = np.stack([a[0] * cn, b * sn, a[2] * dn], axis=1)
    run = integrate(method, top, FREE, np.append(a, TOP0[3:]), 20.0, t, (3, 1))
    assert abs(run.y[:, :3] - exact).max() < bound
    assert abs(momentum(run.y) - momentum(run.y[:1])).max() < bound
    assert abs(np.linalg.norm(run.y[:, 3:], axis=1) - 1.0).max() < 5e-16


@pytest.mark.parametrize("tolerance", [1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("kind", EXPLICIT)
def test_heavy_top_error_follows_tolerance(kind: type[Explicit], tolerance: float) -> None:
    """Against SciPy."""
    t = np.linspace(0.0, 10.0, 57)
    run = integrate(kind(tolerance, tolerance), top, HEAVY, TOP0, 10.0, t, (3, 1))
    assert abs(run.y - top_by_scipy(HEAVY, TOP0, t)).max() < 200 * tolerance


@pytest.mark.parametrize("kind", EXPLICIT)
def test_kepler_orbit_equals_closed_form(kind: type[Explicit]) -> None:
    """Also inside steps."""
    t = np.linspace(0.0, 20.0, 101)
    run = integrate(kind(1e-13, 1e-14), kepler, [], kepler_orbit(0.6, np.zeros(1))[0], 20.0, t)
    assert abs(run.y - kepler_orbit(0.6, t)).max() < 1e-10


def test_decay_equals_radau_and_closed_form() -> None:
    """A state of one number, against SciPy's implicit method and the exponential."""
    t = np.linspace(0.0, 3.0, 10)
    run = integrate(DOP853(1e-11, 1e-13), power, [-2.0, 3.0], [1.5], 3.0, t)
    radau = solve_ivp(lambda _, y: -2.0 * y**3, (0, 3), [1.5], "Radau", t, rtol=1e-10, atol=1e-12)
    assert abs(run.y.T - radau.y).max() < 1e-8
    assert abs(run.y[:, 0] - 1.5 / np.sqrt(1.0 + 4.0 * 1.5**2 * t)).max() < 1e-10


@pytest.mark.parametrize("omega", [1e-9, 1.0, 1e9])
def test_steps_do_not_depend_on_unit_of_time(omega: float) -> None:
    """The first step is good in each unit."""
    t = np.linspace(0.0, 10.0 / omega, 7)
    run = integrate(DOP853(), oscillator, [omega], [1.0, 0.0], t[-1], t)
    assert abs(run.y[:, 0] - np.cos(omega * t)).max() < 1e-9
    assert (run.steps, run.rejected) == (33, 0)
    assert 0.005 < omega * run.knots[1] < 0.5
    still = integrate(DOP853(), oscillator, [omega], [0.0, 0.0], t[-1], t)
    assert not still.y.any()
    assert still.steps < 30


@pytest.mark.parametrize("kind", EXPLICIT)
@pytest.mark.parametrize("second", [2.0**20, 2.0**-20])
def test_error_of_attitude_is_measured_as_angle(kind: type[Explicit], second: float) -> None:
    """A free top in other units of time has other rates and bitwise equal attitudes."""
    t, method = np.linspace(0.0, 5.0, 7), kind(1e-9, 1e-300)
    one = integrate(method, top, FREE, TOP0, t[-1], t, (3, 1))
    y0 = np.append(TOP0[:3] / second, TOP0[3:])
    other = integrate(method, top, FREE, y0, second * t[-1], second * t, (3, 1))
    assert np.array_equal(other.knots, second * one.knots)
    assert np.array_equal(other.y[:, :3], one.y[:, :3] / second)
    assert np.array_equal(other.y[:, 3:], one.y[:, 3:])


@pytest.mark.parametrize(("kind", "most"), [(DOP853, 200), (Tsit5, 400)])
def test_pulse_shortens_steps(kind: type[Explicit], most: int) -> None:
    """Steps that meet the pulse are rejected."""
    width, t = 0.02, np.linspace(0.0, 2.0, 41)
    run = integrate(kind(1e-9, 1e-9, max_step=0.1), pulse, [width], [0.0, 0.0], 2.0, t)
    exact = 0.5 * np.sqrt(np.pi) * (erf((t - 1.0) / width) + erf(1.0 / width))
    assert run.rejected > 0
    assert abs(run.y[:, 1] - exact).max() < 1e-7
    assert run.steps < most


def test_evaluation_counts_equal_kernel_calls() -> None:
    """DOP853: 12 per step, 11 per rejection, 3 per dense output, 2 for the first step."""
    address = kernel_by_numba(counted)
    run = integrate(DOP853(), address, [0.0], [1.0, 0.0], 10.0, [0.0, 10.0])
    assert run.evaluations == run.params[0] == 12 * run.steps + 11 * run.rejected + 2
    run = integrate(DOP853(), address, [0.0], [1.0, 0.0], 10.0, [5.0, 5.001, 10.0])
    assert run.evaluations == run.params[0] == 12 * run.steps + 11 * run.rejected + 5
    # Six a step of Tsitouras's, tried or accepted; its dense output takes none.
    run = integrate(Tsit5(), address, [0.0], [1.0, 0.0], 10.0, [5.0, 5.001, 10.0])
    assert run.evaluations == run.params[0] == 6 * (run.steps + run.rejected) + 2
    run = integrate(RKMK4(0.1), address, [0.0], [1.0, 0.0], 10.0, [5.01])
    assert run.evaluations == run.params[0] == 4 * run.steps + 1
    assert run.steps == 100


def test_steps_do_not_depend_on_attitude_or_quaternion_length() -> None:
    """A rotated initial attitude, and a scaled quaternion."""
    rotated = TOP0.copy()
    rotated[3:] = [0.0, 0.0, 0.0, -3.0]
    one, other = (integrate(DOP853(), top, FREE, y, 20.0, [20.0], (3, 1)) for y in (TOP0, rotated))
    assert abs(one.steps - other.steps) <= 1
    assert abs(one.y - other.y)[:, :3].max() < 1e-8
    turn = Rotation.from_quat(TOP0[3:]) * Rotation.from_quat(-other.y[0, 3:])
    assert (turn.inv() * Rotation.from_quat(one.y[0, 3:])).magnitude() < 1e-8


# --- bits ----------------------------------------------------------------------------------

METHODS: list[Method] = [DOP853(), Tsit5(), RKMK4(0.013)]
ONE, NONE = (3, 1), (0, 0)  # quaternions
PROBLEMS = [(top, HEAVY, TOP0, ONE), (top, HEAVY, TOP0, NONE), (power, [-1.0, 2.0], [1.0], NONE)]
TIMES = np.array([0.0, 0.0, 0.3, 0.301, 1.0, 2.5, 2.5, 4.0])


def same(one: Solution, other: Solution) -> bool:
    """Whether two runs agree in every bit."""
    names = ("y", "knots", "states", "steps", "rejected")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("problem", PROBLEMS)
def test_pauses_do_not_change_results(
    method: Method, problem: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither pauses nor larger arrays change a number."""
    address, params, y0, quaternions = problem
    uninterrupted = integrate(method, address, params, y0, 4.0, TIMES, quaternions)
    monkeypatch.setattr(run_state, "EVALUATIONS_BETWEEN_PAUSES", 1)
    monkeypatch.setattr(drive, "_FIRST_KNOTS", 1)
    fractions: list[float] = []
    paused = integrate(method, address, params, y0, 4.0, TIMES, quaternions, fractions.append)
    assert len(fractions) > uninterrupted.steps
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert same(uninterrupted, paused)
    assert uninterrupted.evaluations == paused.evaluations


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("problem", PROBLEMS)
def test_dense_output_equals_reported_states(method: Method, problem: Any) -> None:
    """States recomputed from stored steps equal those reported by a run."""
    address, params, y0, quaternions = problem
    later = integrate(method, address, params, y0, 4.0, [], quaternions)
    assert later.y.shape == (0, len(y0))
    times = np.sort(np.concatenate([TIMES, np.linspace(0.0, 4.0, 501), later.knots]))
    once = integrate(method, address, params, y0, 4.0, times, quaternions)
    shuffled = np.random.default_rng(0).permutation(len(times))
    assert np.array_equal(later.at(times), once.y)
    assert np.array_equal(once.at(times[shuffled]), once.y[shuffled])
    assert np.array_equal(later.knots, once.knots)
    assert later.at([]).shape == (0, len(y0))


@pytest.mark.parametrize("method", METHODS)
def test_batch_members_equal_single_runs(method: Method) -> None:
    """For any number of threads."""
    rng = np.random.default_rng(1)
    y0, params = rng.normal(size=(23, 7)), np.abs(rng.normal(size=(23, 4))) + 1.0
    runs = [
        integrate(method, top, p, y, 4.0, TIMES, (3, 1)) for p, y in zip(params, y0, strict=True)
    ]
    for threads in (None, 1, 3):
        many = integrate_many(method, top, params, y0, 4.0, TIMES, (3, 1), threads)
        assert np.array_equal(many.y, np.stack([run.y for run in runs]))
        assert many.steps.tolist() == [run.steps for run in runs]
        assert many.evaluations.tolist() == [run.evaluations for run in runs]
        assert many.ok.all()
        assert (many.end == 4.0).all()


def test_failing_member_does_not_affect_others() -> None:
    """It reports a status, and its states up to the failure."""
    params = np.array([[-1.0, 2.0], [1.0, 2.0], [-0.5, 1.0], [np.nan, 1.0], [2.0, 2.0]])
    times = np.array([0.0, 0.25, 3.0])
    many = integrate_many(DOP853(), power, params, np.ones((5, 1)), 3.0, times)
    assert [STATUS[s] for s in many.status.tolist()] == [
        "done", "step size underflow", "done", "not finite", "step size underflow",
    ]  # fmt: skip
    np.testing.assert_allclose(many.end, [3.0, 1.0, 3.0, 0.0, 0.5], atol=1e-9)
    assert many.entry.tolist() == [-1, -1, -1, 0, -1]
    for i in (0, 2):
        one = integrate(DOP853(), power, params[i], [1.0], 3.0, times)
        assert np.array_equal(many.y[i], one.y)
    assert np.isfinite(many.y[[1, 4], :2]).all()
    assert np.isnan(many.y[[1, 4], 2]).all()
    short = integrate_many(DOP853(max_steps=3), power, params[:1], [[1.0]], 3.0, times)
    assert [STATUS[s] for s in short.status.tolist()] == ["too many steps"]
    assert integrate_many(DOP853(), power, np.ones((0, 2)), np.ones((0, 1)), 1.0, []).ok.all()


def test_progress_of_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """The finished fraction of the members, starting at zero."""
    monkeypatch.setattr(several, "_LOOK", 1e-3)
    fractions: list[float] = []
    long = DOP853(max_steps=10**6)
    y0 = np.ones((16, 2))
    integrate_many(
        long, oscillator, np.ones((16, 1)), y0, 1e4, [], threads=1, progress=fractions.append
    )
    assert fractions == sorted(fractions)
    assert fractions[0] < 0.5
    assert set(fractions) <= {k / 16 for k in range(17)}


# --- ends and failures ---------------------------------------------------------------------


@pytest.mark.parametrize("method", [DOP853(), Tsit5(), RKMK4(1.0)])
@pytest.mark.parametrize("t_end", [1e-300, 1e-15])
def test_tiny_end_time_hardly_moves_state(method: Method, t_end: float) -> None:
    """The run takes few steps."""
    run = integrate(method, power, [1.0, 1.0], [1.0], t_end, [0.0, t_end])
    assert run.steps >= 1
    assert run.knots[-1] == t_end
    assert abs(run.y - 1.0).max() < 2e-15


def test_rkmk4_reaches_end_with_equal_steps() -> None:
    """No step is longer than requested."""
    run = integrate(RKMK4(0.3), oscillator, [1.0], [1.0, 0.0], 1.0, [1.0])
    np.testing.assert_allclose(np.diff(run.knots), 0.25, rtol=1e-15)
    assert integrate(RKMK4(0.1), oscillator, [1.0], [1.0, 0.0], 0.3, []).steps == 3


@pytest.mark.parametrize("kind", EXPLICIT)
def test_blow_up_raises_step_size_underflow(kind: type[Explicit]) -> None:
    """The solution 1/(1 − t) cannot be followed to t = 1."""
    with pytest.raises(StepSizeUnderflow, match="singular") as caught:
        integrate(kind(1e-10, 1e-12), power, [1.0, 2.0], [1.0], 3.0, [])
    error = caught.value
    assert error.time == pytest.approx(1.0, abs=1e-9)
    assert error.state.shape == (1,)
    # Steps are parts of what is left, 1/y: they become too short where they are ten bits of t = 1.
    before = integrate(kind(1e-10, 1e-12), power, [1.0, 2.0], [1.0], 1.0 - 1e-7, [])
    relative_step = (np.diff(before.knots) * before.states[:-1, 0])[-6:-2].mean()
    assert 0.5 < error.state[0] * 10.0 * np.finfo(float).eps / relative_step < 2.0
    again = pickle.loads(pickle.dumps(error))
    assert (again.time, str(again)) == (error.time, str(error))


def test_non_finite_entry_is_named() -> None:
    """At the start, inside a step, and at an edge of the rate."""
    for method_type in EXPLICIT:
        with pytest.raises(NonFiniteState, match="number 2 is not finite") as caught:
            integrate(method_type(1e-10, 1e-12), edge, [], [0.0, 0.0, 0.0], 3.0, [])
        assert caught.value.entry == 2
        assert caught.value.time == pytest.approx(0.5, abs=1e-6)
        assert caught.value.time <= 0.5
    assert pickle.loads(pickle.dumps(caught.value)).entry == 2
    for method in METHODS:
        with pytest.raises(NonFiniteState) as caught:
            integrate(method, edge, [], [1.0, 0.0, 0.0], 3.0, [])
        assert (caught.value.entry, caught.value.time) == (2, 0.0)
        assert caught.value.state.tolist() == [1.0, 0.0, 0.0]
    with pytest.raises(NonFiniteState) as caught:
        integrate(RKMK4(0.1), edge, [], [0.0, 0.0, 0.0], 3.0, [])
    assert caught.value.time == pytest.approx(0.5, abs=0.11)
    with pytest.raises(NonFiniteState) as caught:
        integrate(RKMK4(0.1), top, np.full(4, np.nan), TOP0, 3.0, [], (3, 1))
    assert caught.value.entry == 0


@pytest.mark.parametrize("kind", EXPLICIT)
def test_too_many_steps_raise(kind: type[Explicit]) -> None:
    """The error states the time reached; the limit itself is allowed."""
    with pytest.raises(TooManySteps, match="max_steps") as caught:
        integrate(kind(1e-10, 1e-12, max_steps=5), oscillator, [1.0], [1.0, 0.0], 100.0, [])
    error = caught.value
    assert isinstance(error, IntegrationError)
    assert 0.0 < error.time < 5.0
    assert error.state[0] == pytest.approx(np.cos(error.time), abs=1e-9)
    assert integrate(DOP853(max_steps=33), oscillator, [1.0], [1.0, 0.0], 10.0, []).steps == 33


def test_ctrl_c_interrupts_soon() -> None:
    """Also on several threads."""

    def stop(part: float) -> None:
        assert 0.0 < part < 1.0
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        integrate(RKMK4(1e-3), oscillator, [1.0], [1.0, 0.0], 1e4, [], progress=stop)
    long = DOP853(max_steps=10**7)  # ends by itself where the signal does not come through
    main = threading.main_thread().ident
    runs: list[Callable[[], object]] = [
        lambda: integrate(long, oscillator, [1.0], [1.0, 0.0], 1e9, []),
        lambda: integrate_many(long, oscillator, np.ones((9, 1)), np.ones((9, 2)), 1e9, []),
    ]
    # A process that was started in the background ignores the signal unless told otherwise.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        for run in runs:
            timer = threading.Timer(0.1, signal.pthread_kill, (main, signal.SIGINT))
            timer.start()
            with pytest.raises(KeyboardInterrupt):
                run()
            timer.join()
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(
    ("error", "message", "changes"),
    [
        (InputError, "sorted", {"times": [1.0, 0.5]}),
        (InputError, "between 0 and 2 s", {"times": [0.5, 2.5]}),
        (InputError, "between 0", {"times": [-1e-9]}),
        (InputError, "between 0", {"times": [np.nan]}),
        (ShapeError, "times", {"times": 1.0}),
        (InputError, "t_end", {"t_end": 0.0}),
        (InputError, "t_end", {"t_end": np.inf}),
        (ShapeError, "y0 must have shape", {"y0": []}),
        (ShapeError, "y0 must have shape", {"y0": [[1.0]]}),
        (ShapeError, "y0 must be finite", {"y0": [1.0, np.nan]}),
        (InputError, "quaternions: expected", {"quaternions": (0, 1)}),
        (InputError, "quaternions: expected", {"quaternions": (-2, 1)}),
        (InputError, "got zero", {"quaternions": (0, 1), "y0": [0.0] * 4}),
        (InputError, "address", {"address": 0}),
    ],
)
def test_invalid_arguments_are_rejected(
    error: type[InputError], message: str, changes: dict[str, Any]
) -> None:
    """The message names the argument."""
    arguments: dict[str, Any] = {
        "method": DOP853(), "address": oscillator, "params": [1.0], "y0": [1.0, 0.0],
        "t_end": 2.0, "times": [1.0],
    }  # fmt: skip
    with pytest.raises(error, match=message):
        integrate(**(arguments | changes))


def test_invalid_methods_and_batches_are_rejected() -> None:
    """Invalid options, times of `at`, and batches."""
    for make in (
        lambda: DOP853(rtol=0.0),
        lambda: DOP853(atol=-1.0),
        lambda: DOP853(max_steps=0),
        lambda: DOP853(max_steps=1.5),  # type: ignore[arg-type]
        lambda: DOP853(max_step=0.0),
        lambda: RKMK4(0.0),
        lambda: integrate(DOP853(), oscillator, [1.0], [1.0, 0.0], 1.0, []).at([1.1]),
        lambda: integrate_many(DOP853(), oscillator, [[1.0]], [[1.0, 0.0]] * 2, 1.0, []),
        lambda: integrate_many(DOP853(), oscillator, [[1.0]], [[1.0, 0.0]], 1.0, [], threads=0),
    ):
        with pytest.raises(InputError):
            make()
