"""The bounds of a comparison and the dependence of the verdict on each of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from scipy.special import spherical_jn
from tampering import offset, tampered
from trees import random_model

import pinred
from pinred.cli.motion_commands import print_comparison
from pinred.forces import Torque
from pinred.judge.audit import equation_errors
from pinred.judge.compare import closest_defect
from pinred.judge.reference_solution import FullMotion, FullState
from pinred.judge.step_defects import compute_defects, unresolved_forces
from pinred.judge.verdict import EXIT_CODES, Verdict, _closest

RTOL, ATOL = 1e-8, 5e-9
TOLERANCE = RTOL + ATOL
TIGHT = 1.01e-10  # sum of the default tolerances


@cache
def cat() -> pinred.Trajectory:
    """Simulate the falling cat for one second."""
    return pinred.simulate(pinred.load("falling_cat"), duration=1.0, rtol=RTOL, atol=ATOL)


@cache
def passing_report() -> pinred.Report:
    """Return its comparison."""
    return pinred.compare(cat())


def test_repr_names_check_closest_to_its_bound() -> None:
    """The one-line summary names the check with the largest ratio to its bound."""
    report = passing_report()
    for name, bound in (("energy_drift", "drift_bound"), ("field_error", "field_bound")):
        near = replace(report, **{name: 0.9 * getattr(report, bound)})
        (words,) = (item for item in near.checks if near.checks[item][0] == getattr(near, name))
        assert words in repr(near)
        assert words not in repr(report)
    assert "defect" in repr(replace(report, defect=1e-20, defect_bound=0.0))


def test_closest_error_with_zero_bound_or_no_joint() -> None:
    """Any error exceeds a bound of zero; without joints there is no error."""
    none = np.empty((3, 0))
    assert _closest(none, none) == (0.0, 0.0)
    errors, bounds = np.array([0.05, 1e-9, 2.0]), np.array([0.0, 1e-8, 4.0])
    assert _closest(errors, bounds) == (0.05, 0.0)
    assert _closest(errors[1:], bounds[1:]) == (2.0, 4.0)
    assert _closest(np.zeros(2), np.array([0.0, 1.0]))[0] == 0.0
    assert np.isnan(_closest(np.array([0.1, np.nan]), np.ones(2))[0])


def test_report_has_documented_bounds() -> None:
    """The bounds are those in docs/comparison.md."""
    report = passing_report()
    assert report.passed
    assert report.equations_bound == 1e-12
    assert report.defect_bound == pytest.approx(3.0 * TOLERANCE)
    assert report.drift_bound == pytest.approx(100.0 * TOLERANCE)
    assert report.field_bound == 1e-9
    assert report.reference_bound == pytest.approx(100.0 * TOLERANCE * report.growth[-1])
    assert report.told == len(report.t)


NUMBERS = {
    "equations": "equations_bound",
    "defect": "defect_bound",
    "energy_drift": "drift_bound",
    "momentum_drift": "drift_bound",
    "field_error": "field_bound",
    "reference_error": "reference_bound",
}


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("part", [1.01, np.inf, np.nan])
def test_verdict_fails_for_each_number_above_its_bound(name: str, part: float) -> None:
    """A value slightly above its bound or NaN fails; slightly below it passes."""
    bound = getattr(passing_report(), NUMBERS[name])
    assert replace(passing_report(), **{name: 0.99 * bound}).passed
    report = replace(passing_report(), **{name: part * bound})
    assert report.verdict is Verdict.FAILED
    assert sum(not value <= most for value, most in report.checks.values()) == 1


@pytest.mark.parametrize("kind", ["shape", "rotation", "position"])
@pytest.mark.parametrize("part", [1.01, np.inf, np.nan])
@pytest.mark.parametrize("when", [1, 50, -1])
def test_verdict_fails_for_each_single_error(kind: str, part: float, when: int) -> None:
    """One entry of one joint at one time fails, unless that time cannot be judged."""
    errors = getattr(passing_report(), f"{kind}_errors").copy()
    bounds = getattr(passing_report(), f"{kind}_bounds")
    where = (when, 1) if errors.ndim == 2 else (when,)
    errors[where] = 0.99 * bounds[where]
    assert replace(passing_report(), **{f"{kind}_errors": errors}).passed
    errors = errors.copy()
    errors[where] = part * bounds[where]
    report = replace(passing_report(), **{f"{kind}_errors": errors})
    assert report.verdict is Verdict.FAILED
    told = replace(report, told=when % len(report.t), reasons=("",))
    assert told.verdict is Verdict.CANNOT_TELL


def test_perturbation_is_a_millionth_of_each_unit() -> None:
    """Units are the number, a radian, the radius of gyration, and rates that cover these."""
    system = cat().system
    full = FullState(cat().scene)
    y0 = full.state(
        np.append(np.full(3, 50.0), [0.0, 0.0, 0.0, 1.0]),
        np.full(3, 2.0),
        np.full(6, 0.1),
        np.full(3, 4.0),
    )
    kicked = np.abs(full.perturb(y0, 5.0, 1e-6) - y0) / 1e-6
    radius = full.totals.radius_of_gyration(system.q(y0[:7], y0[7:10]))
    expected = (
        [max(5e-4, radius)] * 3
        + [1.0] * 4
        + [2.0] * 3
        + [max(0.1, 0.2 * radius)] * 3
        + [0.2] * 3
        + [4.0] * 3
    )
    assert kicked == pytest.approx(expected, rel=1e-4)


def test_growth_of_unstable_motion_is_hyperbolic() -> None:
    """For a beanie on a repelling spring the perturbation grows as cosh."""
    system = pinred.load("elroys_beanie")
    scene = pinred.Scene(system=system, springs={"beanie": (-6.0, 0.0)}, x0=[0.0], duration=2.0)
    full = FullState(scene)
    y0 = full.state(scene.start.pose, scene.start.x, scene.start.xi, scene.start.xdot)
    times = np.linspace(0.0, 2.0, 11)
    growth = full.growth(y0, full.run(y0, times, 1e-12, 1e-14), times, 1e-12, 1e-14)
    # x grows as cosh 3t ± sinh(3t) / 3T, depending on the sign of the perturbed rate.
    most, least = (np.cosh(3 * times) + s * np.sinh(3 * times) / 6 for s in (1, -1))
    assert (growth >= 0.99 * np.maximum(1.0, least)).all()
    assert (growth <= 1.3 * most + 1.0).all()


@pytest.mark.parametrize("error", [1e-300, np.nan])
def test_zero_bound_passes_zero_error_only(error: float) -> None:
    """Any positive error or NaN fails a bound of zero."""
    bounds, errors = (
        passing_report().rotation_bounds.copy(),
        passing_report().rotation_errors.copy(),
    )
    bounds[5] = errors[5] = 0.0
    assert replace(passing_report(), rotation_errors=errors.copy(), rotation_bounds=bounds).passed
    errors[5] = error
    report = replace(passing_report(), rotation_errors=errors, rotation_bounds=bounds)
    assert report.verdict is Verdict.FAILED


def test_errors_of_slow_joint_next_to_fast_wheels_fail() -> None:
    """Each joint has the unit of its motion: wheels rotate by 300 rad, the panel by 1."""
    traj = pinred.simulate(pinred.load("reaction_wheel_satellite"))
    report = pinred.compare(traj)
    assert report.passed, str(report)
    assert report.shape_bounds[-1, 3] > 100.0 * report.shape_bounds[-1, 0]
    result = pinred.compare(tampered(traj, offset("x", 0, 1e-6)))
    value, bound = result.checks["shape error [rad | m]"]
    assert value > bound
    assert result.verdict is Verdict.FAILED


@pytest.mark.parametrize("away", [1e3, 1e5])
@pytest.mark.sampled
def test_jump_of_distant_base_fails(away: float) -> None:
    """A base 100 km from the origin that travels one metre and jumps by 1e-6 m fails."""
    pose0 = [away, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    traj = pinred.simulate(pinred.load("falling_cat"), duration=1.0, pose0=pose0)
    assert pinred.compare(traj).passed
    report = pinred.compare(tampered(traj, offset("q", 0, 1e-6)))
    value, bound = report.checks["position error [m]"]
    assert value == pytest.approx(1e-6, rel=1e-3)
    assert value > bound


def test_position_bound_includes_round_off_of_distance() -> None:
    """At a distance of 1000 km, 1e-14 of the distance is added to the bound."""
    pose0 = [1e6, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    traj = pinred.simulate(pinred.load("falling_cat"), duration=1.0, pose0=pose0)
    report = pinred.compare(traj)
    assert report.position_bounds - 10.0 * report.rotation_bounds == pytest.approx(1e-8, rel=0.01)


def test_size_of_motion_is_distance_travelled_and_largest_joint_value() -> None:
    """Least units: radius of gyration, 1e-5 of the distance from the origin, 1 rad."""
    full = FullState(cat().scene)
    q = np.array(cat().q[:2])
    q[:, :3] = [[4e6, 0.0, 0.0], [4e6, 7.0, 0.0]]
    x = np.array([[0.5, 3.0, -9.0]] * 2)
    assert full.size(FullMotion(x=x, q=q)).position == pytest.approx(40.0)
    q[:, 0] = 10.0
    size = full.size(FullMotion(x=x, q=q))
    assert size.position == pytest.approx(7.0)
    assert size.joints == pytest.approx([1.0, 3.0, 9.0])
    q[1] = q[0]
    radius = full.totals.radius_of_gyration(q[0])
    assert full.size(FullMotion(x=x, q=q)).position == pytest.approx(radius)


def test_size_of_prismatic_joint_is_at_least_radius_of_gyration() -> None:
    """Small translations are measured in the radius of gyration, small rotations in radians."""
    system = pinred.load(random_model("SE3", 6, 2))
    full = FullState(pinred.Scene(system=system, seed=0))
    q = system.q(system.group.identity(), np.zeros(6))
    radius = full.totals.radius_of_gyration(q)
    assert {"m", "rad"} == set(system.units)
    result = full.size(FullMotion(x=np.zeros((1, 6)), q=q[None])).joints
    sizes = {"m": radius, "rad": 1.0}
    assert result == pytest.approx([sizes[unit] for unit in system.tree.units])


@pytest.mark.parametrize("away", [0.0, 3.0])
def test_size_of_small_robot_at_rest(away: float) -> None:
    """The unit is its radius of gyration, or 1e-5 of its distance from the origin."""
    model = random_model("SE3", 2, 0, armature=False)
    for i in range(1, model.njoints):
        at, body = model.jointPlacements[i], model.inertias[i]
        model.jointPlacements[i] = pin.SE3(at.rotation, 1e-6 * at.translation)
        model.inertias[i] = pin.Inertia(body.mass, 1e-6 * body.lever, 1e-12 * body.inertia)
    system = pinred.load(model)
    full = FullState(pinred.Scene(system=system, seed=0))
    q = system.q(system.group.identity(), np.zeros(2))
    q[0] = away
    size = full.size(FullMotion(x=np.zeros((1, 2)), q=q[None]))
    assert full.totals.radius_of_gyration(q) < 1e-5
    assert size.position == pytest.approx(max(full.totals.radius_of_gyration(q), 1e-5 * away))
    assert size.away == away


@pytest.mark.parametrize("rate", [0.0, 3e-13])
def test_compare_at_rest_cannot_tell(rate: float) -> None:
    """Without motion the equations are not tested."""
    traj = pinred.simulate(pinred.load("coupled_planar"), x0=[0.3], xdot0=[rate], duration=1.0)
    report = pinred.compare(traj)
    assert report.verdict is Verdict.CANNOT_TELL
    assert "nothing moves" in report.reasons[0]


def test_compare_of_tiny_motion_passes() -> None:
    """A motion of 5e-12 rad is judged."""
    traj = pinred.simulate(pinred.load("coupled_planar"), x0=[0.3], xdot0=[5e-12], duration=1.0)
    assert not pinred.compare(traj).reasons


@pytest.mark.parametrize(
    ("name", "speed"),
    [("falling_cat", 1e-160), ("falling_cat", 1e-20), ("planar_chain5", 1e-20)],
)
@pytest.mark.sampled
def test_compare_of_underflowing_motion_does_not_fail(name: str, speed: float) -> None:
    """Squares of its momenta and rates underflow."""
    system = pinred.load(name)
    rng = np.random.default_rng(0)
    traj = pinred.simulate(
        system, x0=rng.normal(size=system.m), xdot0=speed * rng.normal(size=system.m),
        xi0=speed * rng.normal(size=system.r), duration=1.0,
    )  # fmt: skip
    report = pinred.compare(traj)
    assert report.verdict is Verdict.CANNOT_TELL, str(report)


@pytest.mark.parametrize("speed", [1.0, 1e-3])
@pytest.mark.parametrize("name", ["falling_cat", "planar_chain5"])
@pytest.mark.parametrize("away", [1e6, 1e9])
@pytest.mark.sampled(4)
def test_compare_of_distant_base_does_not_fail(name: str, speed: float, away: float) -> None:
    """The base is 1e9 m from the origin."""
    system = pinred.load(name)
    pose0 = np.array(system.group.identity())
    pose0[:2] = away, -0.7 * away
    traj = pinred.simulate(system, xdot0=speed * np.ones(system.m), xi0=speed * np.ones(system.r),
                           x0=0.3 * np.ones(system.m), pose0=pose0, duration=1.0)  # fmt: skip
    assert pinred.compare(traj).verdict is not Verdict.FAILED, str(pinred.compare(traj))


@pytest.mark.slow
def test_compare_of_chaos_at_loose_tolerance_cannot_tell() -> None:
    """Thirty seconds of chaos at a tolerance of 1e-3."""
    traj = pinred.simulate(
        pinred.load("double_spherical_pendulum"), x0=[2.0, 1.0, 2.5], xdot0=[4.0, -5.0, 6.0],
        xi0=[3.0], duration=30.0, rtol=1e-3, atol=1e-5,
    )  # fmt: skip
    report = pinred.compare(traj)
    assert report.verdict is Verdict.CANNOT_TELL, str(report)


def test_exit_codes_of_verdicts(capsys: pytest.CaptureFixture[str]) -> None:
    """0 for PASSED, 1 for FAILED, 3 for CANNOT TELL."""
    assert print_comparison(cat()) == 0
    assert print_comparison(tampered(cat(), offset("x", 0, 1e-3))) == 1
    still = pinred.simulate(pinred.load("coupled_planar"), x0=[0.3], duration=1.0)
    assert print_comparison(still) == 3
    said = capsys.readouterr().out
    assert [word for word in Verdict if f"verdict: {word}" in said] == list(Verdict)
    assert EXIT_CODES == {"PASSED": 0, "FAILED": 1, "CANNOT TELL": 3}


def test_report_is_true_if_passed() -> None:
    """Its one-line summary names the check closest to its bound."""
    assert bool(passing_report()) is True
    assert bool(replace(passing_report(), reasons=("no",))) is False
    failed = replace(passing_report(), equations=1.0)
    assert bool(failed) is False
    assert [str(report).count("FAILED") for report in (passing_report(), failed)] == [0, 2]
    for report in (passing_report(), failed, replace(passing_report(), reasons=("no reason",))):
        assert "\n" not in repr(report)
        assert str(report.verdict) in repr(report)
    assert "equations of motion [relative] 1.0e+00 of 1.0e-12" in repr(failed)
    assert "no reason" in repr(replace(passing_report(), reasons=("no reason",)))


def test_closest_defect_depends_on_forces_and_mean() -> None:
    """Steps with fast forces may have 100 tolerances, and 3 impulses, if the mean is at most 3."""
    steps, impulses, fast = np.full(200, 0.01), np.zeros(200), np.zeros(200, dtype=bool)
    assert closest_defect(steps, impulses, fast, 2.0) == (0.01, 6.0)
    steps[7], impulses[7] = 80.0, 25.0
    assert closest_defect(steps, impulses, fast, 2.0) == (80.0, 75.0)
    impulses[7] = 1e3
    assert closest_defect(steps, impulses, fast, 2.0) == (80.0, 200.0)
    steps[8] = 6.1
    assert closest_defect(steps, impulses, fast, 2.0) == (6.1, 6.0)
    steps[8], fast[8] = 19.0, True
    assert closest_defect(steps, impulses, fast, 2.0) == (19.0, 20.0)
    many = np.full(200, 6.1)
    assert closest_defect(many, np.full(200, 1e3), many > 0.0, 2.0) == (6.1, 6.0)


@pytest.mark.parametrize("size", [5.0, 20.0])
@pytest.mark.parametrize("torque", [0.0, 0.05])
@pytest.mark.sampled
def test_jump_at_one_step_end_fails_defects(size: float, torque: float) -> None:
    """A few tolerances fail in the line of defects, also where a slow torque acts."""
    slow = Torque(lambda s: {"bend": torque * ca.sin(3.0 * s.t)})
    forces = [slow] if torque else []
    traj = pinred.simulate(pinred.load("falling_cat"), seed=2, duration=2.0, forces=forces)
    assert pinred.compare(traj).passed
    knots = traj.motion.knots
    when, unit = knots[len(knots) // 2], max(1.0, np.abs(traj(knots).x).max())

    def change(state: pinred.State) -> pinred.State:
        x = state.x.copy()
        x[state.t >= when, 0] += size * TIGHT * unit
        return replace(state, x=x)

    report = pinred.compare(tampered(traj, change))
    assert report.verdict is Verdict.FAILED
    assert report.defect == pytest.approx(size * TIGHT, rel=0.1)
    assert report.defect_bound == pytest.approx(3.0 * TIGHT)


# Further tests check the rule, and the impulse of a force.
@pytest.mark.by_hand
def test_step_in_flank_of_pulse_may_exceed_bound() -> None:
    """Equal steps of DOP853 miss the pulse by tens of tolerances, and an added jump fails."""

    def torque(s: Any) -> dict[str, Any]:
        t = s.t - 0.53
        return {"beanie": 5e-4 * ca.cos(60.0 * t) * ca.exp(-((t / 0.05) ** 2))}

    scene = pinred.Scene(
        system=pinred.load("elroys_beanie"), xdot0=[1.0], xi0=[0.3], forces=[Torque(torque)],
        duration=2.0,
    )  # fmt: skip
    equal = pinred.DOP853(rtol=0.1, atol=0.1, max_step=0.05)
    loose = pinred.simulate(scene, method=equal)
    traj = pinred.Trajectory(scene, loose.motion, loose.run)
    assert compute_defects(traj, FullState(scene)).worst > 15.0 * TIGHT
    assert pinred.compare(traj).passed
    for when, passes in ((0.55, True), (1.5, False)):

        def change(state: pinred.State, when: float = when) -> pinred.State:
            x = state.x.copy()
            x[state.t >= when - 1e-9, 0] += 20.0 * TIGHT
            return replace(state, x=x)

        report = pinred.compare(tampered(traj, change))
        assert (report.defect <= report.defect_bound) == passes, str(report)


def test_impulse_of_force_is_that_of_its_legendre_series() -> None:
    """The coefficient of P_k in the cosine about the middle of a step is (2k + 1) j_k(ω h/2)."""
    system, rate = pinred.load("elroys_beanie"), 120.0
    middle = 0.325

    def torque(s: Any) -> dict[str, Any]:
        return {"beanie": 0.1 * ca.cos(rate * (s.t - middle))}

    scene = pinred.Scene(
        system=system, xdot0=[1.0], xi0=[0.3], forces=[Torque(torque)], duration=1.0
    )
    equal = pinred.DOP853(rtol=0.1, atol=0.1, max_step=0.05)
    traj = pinred.simulate(scene, method=equal)
    steps = len(traj.motion.knots) - 1
    assert steps == 20
    full, suspect = FullState(scene), np.arange(steps) == 6
    impulses = unresolved_forces(traj, full, suspect)
    k = np.arange(8, 16, 2)
    tail = ((2 * k + 1) * np.abs(spherical_jn(k, 0.025 * rate))).sum()
    change = np.linalg.solve(pin.crba(system.model, system.data, traj.q[0]), [0.0, 0.1])
    units = np.abs(np.hstack([traj(traj.motion.knots).xi, traj(traj.motion.knots).xdot])).max(
        axis=0
    )
    assert impulses[6] == pytest.approx(0.05 * tail * np.abs(change / units).max(), rel=1e-6)
    assert (impulses[~suspect] == 0.0).all()


def test_round_off_of_time_is_no_error_of_equations() -> None:
    """The integrated time is off by 1e-14 s, and this torque changes at 4000 rad/s."""

    def torque(s: Any) -> dict[str, Any]:
        return {"bend": 3.0 * ca.sin(4000.0 * s.t) * ca.exp(-(((s.t - 1.5) / 0.1) ** 2))}

    force = Torque(torque)
    traj = pinred.simulate(pinred.load("falling_cat"), seed=1, duration=1.6, forces=[force])
    full = FullState(traj.scene)
    assert equation_errors(traj, full, np.linspace(1.4, 1.6, 41)).max() < 1e-13
