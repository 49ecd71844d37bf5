"""The choice of an integrator: its rules, and that the chosen integrator is accurate."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import method_study
import numpy as np
import pytest
from method_study import held_robot
from trees import limbed_model

import pinred
from pinred import DOP853, AdaptiveGauss, Gauss, Radau
from pinred.forces import PD, Controller, Damper, Limit, Spring, Torque
from pinred.judge.reference_solution import FullMotion, FullState
from pinred.signals import Hold
from pinred.simulation.choose_method import LANES_GAIN, Choice, radau_gain, rates_near_rest
from pinred.simulation.plan import members_plan, plan_of


def scene(system: pinred.System, **options: Any) -> pinred.Scene:
    """Return a scene with one report, at its end."""
    settings: dict[str, Any] = {"times": [1.0], "seed": 1} | options
    return pinred.Scene(system=system, **settings)


def test_stated_method_is_used() -> None:
    """A method in the scene is not replaced."""
    system = pinred.load("falling_cat")
    for method in (Gauss(0.1), DOP853(1e-5, 1e-7)):
        assert plan_of(scene(system, method=method)).choice.method is method


def test_chain_gets_adaptive_gauss() -> None:
    """Without identical branches eight stages in SIMD lanes are faster."""
    for name in ("planar_chain5", "falling_cat"):
        choice = plan_of(scene(pinred.load(name), rtol=1e-9, atol=1e-11)).choice
        assert choice.method == AdaptiveGauss(1e-10, 1e-12)
        assert "a sweep costs" in choice.why


def test_identical_branches_get_dop853() -> None:
    """Four legs fill the SIMD lanes; two arms leave some, which pay off at tight tolerances."""
    four = pinred.load(limbed_model("SE3", 4, 3, 1))
    two = pinred.load(limbed_model("SE3", 2, 3, 1))
    assert isinstance(plan_of(scene(four, rtol=1e-10)).choice.method, DOP853)
    assert isinstance(plan_of(scene(two, rtol=1e-4)).choice.method, DOP853)
    assert isinstance(plan_of(scene(two, rtol=1e-12)).choice.method, AdaptiveGauss)


def test_reports_and_stops_get_dop853() -> None:
    """DOP853 repeats less work with many reports, tables or controllers."""
    system = pinred.load("falling_cat")
    joint = system.shape_names[0]
    many = scene(system, times=np.linspace(0.0, 1.0, 50))
    assert plan_of(many).choice.method == DOP853(*many.tolerance)
    assert "48 reports" in plan_of(many).choice.why
    few = scene(system, times=[0.0, 0.5, 1.0])
    assert isinstance(plan_of(few).choice.method, AdaptiveGauss)
    stops: list[Any] = [
        Controller(lambda t, x, xdot, mu: {joint: 0.1}, period=0.1),  # noqa: ARG005
        Torque({joint: Hold([0.0, 0.5, 1.0], [0.0, 1.0, 0.0])}),
    ]
    for force in stops:
        assert "in segments" in plan_of(scene(system, forces=[force])).choice.why


@pytest.mark.slow
@pytest.mark.parametrize("damping", [1.0, 300.0])
@pytest.mark.sampled
def test_stiff_forces_get_radau(damping: float) -> None:
    """Radau is chosen if stability limits the steps; its motion agrees with DOP853 and ABA."""
    cat = pinred.load("falling_cat")
    joint = cat.shape_names[0]
    forces = [Spring(joint, 5 * damping), Damper(joint, damping)]
    hard = scene(cat, forces=forces, rtol=1e-8, atol=1e-10)
    stiff = damping > 10
    assert isinstance(plan_of(hard).choice.method, Radau) == stiff
    assert ("stability alone" in plan_of(hard).choice.why) == stiff
    traj = pinred.simulate(hard)
    other = pinred.simulate(hard, rtol=1e-9, atol=1e-11, method=DOP853())
    np.testing.assert_allclose(traj.x, other.x, atol=1e-7)
    assert pinred.compare(pinred.simulate(hard, times=[0.002])).passed
    # A spring alone swings, and has to be followed.
    swinging = scene(cat, forces=[Spring(joint, 1e6)], rtol=1e-8)
    assert not isinstance(plan_of(swinging).choice.method, Radau)


@pytest.mark.parametrize("oscillation", [0.0, 1e4])
def test_radau_needs_slow_oscillations_and_costs_for_many_joints(oscillation: float) -> None:
    """Radau's steps resolve oscillations, and batches prefer DOP853 in SIMD lanes for longer."""
    chain = pinred.load("planar_chain5")
    first, last = chain.shape_names[0], chain.shape_names[-1]

    def held(damping: float) -> pinred.Scene:
        forces = [Damper(first, damping), Spring(last, oscillation)]
        return scene(chain, forces=forces, times=[2.0], rtol=1e-8)

    # At m = 5 and without oscillation the gain is 12 λT/4 / (35 · 500).
    hard, soft = held(3000.0), held(10.0)
    swings = oscillation > 0.0
    assert isinstance(plan_of(hard).choice.method, Radau) != swings
    assert not isinstance(plan_of(soft).choice.method, Radau)
    if not swings:
        rates = rates_near_rest(hard)
        assert radau_gain(hard) == pytest.approx(12.0 * rates.decay * 2.0 / 4.0 / 17500.0)
        between = held(3000.0 * LANES_GAIN / radau_gain(hard))
        assert isinstance(plan_of(between).choice.method, Radau)
        assert isinstance(members_plan(between).method, DOP853)
        assert isinstance(members_plan(held(3000.0 * 1e3 / radau_gain(hard))).method, Radau)


def test_damped_forces_get_dop853() -> None:
    """Long steps would not converge at moderate damping; gentle damping changes nothing."""
    chain = pinred.load("planar_chain5")
    joint = chain.shape_names[0]

    def choose(stiffness: float, damping: float) -> Choice:
        forces = [Spring(joint, stiffness), Damper(joint, damping)]
        return plan_of(scene(chain, forces=forces, times=[2.0], rtol=1e-8)).choice

    assert isinstance(choose(1e4, 100.0).method, DOP853)
    assert "forces decay at" in choose(1e4, 100.0).why
    assert isinstance(choose(1e2, 1.0).method, AdaptiveGauss)


def _evaluations_per_sweep(held: pinred.Scene) -> float:
    """Return the evaluations of DOP853 divided by the sweeps of AdaptiveGauss."""
    sweeps = pinred.simulate(held, method="AdaptiveGauss").run.evaluations / 8
    return pinred.simulate(held, method="DOP853").run.evaluations / sweeps


def test_damping_at_tight_tolerances_gets_adaptive_gauss() -> None:
    """Excited fast modes shorten the steps of DOP853 there; AdaptiveGauss does less work."""
    held = held_robot(64)
    choice = plan_of(held).choice
    assert isinstance(choice.method, AdaptiveGauss)
    assert "each e-fold costs" in choice.why
    assert _evaluations_per_sweep(held) > 4.8
    # Loose tolerances and batches are left to DOP853.
    assert isinstance(plan_of(replace(held, rtol=1e-7)).choice.method, DOP853)
    assert isinstance(members_plan(held).method, DOP853)


@pytest.mark.by_hand("45-2100.0-10.0")
@pytest.mark.parametrize(("seed", "folds", "radians"), [(45, 2.1e3, 10.0), (149, 3.2e4, 460.0)])
def test_motions_that_settle_get_dop853(seed: int, folds: float, radians: float) -> None:
    """Without oscillation, or after a long decay, its steps are long: it does less work."""
    held = held_robot(seed)
    rates = rates_near_rest(held)
    expected = pytest.approx([folds, radians], rel=0.1)
    assert [rates.decay * held.end, rates.oscillation * held.end] == expected
    assert isinstance(plan_of(held).choice.method, DOP853)
    assert _evaluations_per_sweep(held) < 4.0


def test_arm_held_by_pd_control_does_not_get_radau() -> None:
    """The steps of Radau cost most for many joints, of which PD control holds six here."""
    servicer = pinred.load(limbed_model("SE3", 2, 6, 0))
    held = dict.fromkeys(servicer.shape_names[6:], 0.0)
    options: dict[str, Any] = {"forces": [PD(held, 2000.0, 100.0)], "times": [2.0]}
    chosen = plan_of(scene(servicer, **options)).choice
    assert servicer.m >= 12
    assert not isinstance(chosen.method, Radau)
    assert isinstance(members_plan(scene(servicer, **options)).method, DOP853)


def test_constant_rates_get_dop853() -> None:
    """If all joints are cyclic and the base turns about one axis, one step is exact."""
    for name in ("elroys_beanie", "coupled_planar"):
        choice = plan_of(pinred.Scene(system=pinred.load(name), times=[5.0])).choice
        assert isinstance(choice.method, DOP853)
        assert "all rates are constant" in choice.why
        assert pinred.simulate(pinred.load(name), times=[5.0]).run.steps < 12
    beanie = pinred.load("elroys_beanie")
    sprung = pinred.Scene(system=beanie, times=[5.0], springs={"beanie": (1.0, 0.0)})
    assert "constant" not in plan_of(sprung).choice.why
    assert "constant" not in plan_of(scene(pinred.load("rigid_body"))).choice.why


def test_wheels_do_not_count_as_branches_in_lanes() -> None:
    """Cyclic wheels leave the lanes of a sweep free."""
    wheels = pinred.load("reaction_wheel_satellite")
    choice = plan_of(pinred.Scene(system=wheels, times=[10.0])).choice
    assert isinstance(choice.method, AdaptiveGauss)
    assert "a sweep costs 1.9" in choice.why


def test_rates_of_a_damped_joint() -> None:
    """One joint has λ² M + λ D + K = 0, with the metric I1 I2 / (I1 + I2) of Elroy's beanie."""
    beanie = pinred.load("elroys_beanie")
    M = float(pinred.Reduction(beanie).reduced_metric([0.0])[0, 0])
    K, D = 3.0, 50.0
    forces = [Spring("beanie", K), Damper("beanie", D)]
    rates = rates_near_rest(scene(beanie, forces=forces))
    assert rates.decay == pytest.approx((D + np.sqrt(D * D - 4 * M * K)) / (2 * M), rel=1e-6)
    assert rates.oscillation == 0.0
    weak = rates_near_rest(scene(beanie, forces=[Spring("beanie", K), Damper("beanie", 0.1)]))
    assert weak.decay == pytest.approx(0.1 / (2 * M), rel=1e-6)
    assert weak.oscillation == pytest.approx(np.sqrt(K / M - (0.05 / M) ** 2), rel=1e-6)


@pytest.mark.by_hand("limit0")
@pytest.mark.parametrize("limit", [Limit(0.5), Limit(0.5, smooth=True)])
def test_kinks_get_dop853(limit: Limit) -> None:
    """Long steps miss a kink, and their error estimate is wrong there."""
    system = pinred.load("falling_cat")
    forces = [PD({system.shape_names[0]: 0.5}, kp=2.0, kd=0.1, limit=limit)]
    limited = scene(system, times=[2.0], forces=forces, rtol=1e-8, atol=1e-10)
    assert isinstance(plan_of(limited).choice.method, AdaptiveGauss if limit.smooth else DOP853)
    assert ("kinks" in plan_of(limited).choice.why) != limit.smooth
    traj, start = pinred.simulate(limited), limited.start
    full = FullState(limited)
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    reference = full.run(y0, limited.report_times, 1e-12, 1e-14)
    error = full.distance(reference, FullMotion(x=traj.x, q=traj.q))
    assert max(error.shape.max(), error.rotation.max()) < 1e-7


@pytest.mark.parametrize(
    "force",
    [
        lambda x: ca.fabs(x), lambda x: ca.fmax(x, 0.1), lambda x: ca.sign(x),
        lambda x: ca.if_else(x > 0.1, x, 0.1), lambda x: ca.floor(x), lambda x: ca.fmod(x, 0.3),
    ],
)  # fmt: skip
def test_piecewise_functions_are_detected(force: Any) -> None:
    """All piecewise functions of CasADi count as kinks."""
    system = pinred.load("falling_cat")
    joint = system.shape_names[0]
    torque = Torque(lambda t, x, xdot, mu: {joint: force(x[0])})  # noqa: ARG005
    assert "kinks" in plan_of(scene(system, forces=[torque])).choice.why
    smooth = Torque(lambda t, x, xdot, mu: {joint: ca.tanh(x[0]) + ca.exp(-t)})  # noqa: ARG005
    assert "kinks" not in plan_of(scene(system, forces=[smooth])).choice.why


@pytest.mark.parametrize("method", ["Gauss(0.01)", "AdaptiveGauss", "DOP853", "Radau"])
@pytest.mark.parametrize("kinks", [True, False])
def test_gauss_methods_warn_of_kinks(method: str, kinks: bool) -> None:
    """Their errors at kinks are not controlled; conditions on time are stops instead."""
    system = pinred.load("falling_cat")
    joint = system.shape_names[0]
    torque = Torque(lambda s: {joint: -0.1 * ca.fabs(s.xdot[0] if kinks else s.t - 0.3)})
    plan = plan_of(scene(system, forces=[torque], method=method))
    assert bool(plan.notices) == (kinks and "Gauss" in method)


def test_explain_prints_method_and_reason(capsys: pytest.CaptureFixture[str]) -> None:
    """explain= prints the method with its reason; the run states the same method."""
    traj = pinred.simulate(pinred.load("planar_chain5"), seed=1, times=[0.5], explain=True)
    assert (
        "method: AdaptiveGauss (a sweep costs 1.9 evaluations and saves 3.7"
        in capsys.readouterr().out
    )
    assert traj.run.method == "AdaptiveGauss"
    assert pinred.compare(traj).passed


def test_study_compares_the_choice_with_the_fastest_accurate_method(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The ratio refers to the fastest method whose error is at most that of the chosen one."""
    wall = dict(zip(method_study.CANDIDATES, (2.0, 4.0, 3.0, 1.0), strict=True))
    error = dict(zip(method_study.CANDIDATES, (1e-9, 1e-10, 1e-10, 1e-6), strict=True))
    compared = partial(method_study.choice_of, "made", cpu=wall, error=error)
    assert compared("DOP853").ratio == 1.0  # Radau is less accurate.
    assert compared("Tsit5").ratio == 4.0 / 3.0  # of AdaptiveGauss
    monkeypatch.setattr(method_study, "CANDIDATES", ("DOP853", "AdaptiveGauss"))
    table = method_study.compare_methods(["planar1"], 0)
    assert "of 1 scenes within 1.3 times the fastest method" in str(table)
