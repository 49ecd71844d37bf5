"""Invalid forces, plans and options are rejected with clear messages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred.forces import (
    PD,
    ComputedTorque,
    Controller,
    Damper,
    Limit,
    PotentialEnergy,
    Spring,
    Torque,
    Wrench,
)
from pinred.signals import Expression, Fourier, Hold, Linear, Spline

CAT = pinred.load("falling_cat")
A, B, C = CAT.shape_names
WAVE = Fourier(0.0, [], [0.3], 1.0)
NAN = float("nan")


def law(value: Any) -> Callable[..., Any]:
    """A function with a constant result."""
    return lambda *_: value


MX = ca.MX.sym("q")
UNKNOWN = "no shape joint 'x'; the joints are bend, sway, twist"
BAD: list[tuple[Callable[[], Any], str]] = [
    (lambda: Spring("x", 1.0), f"spring x: {UNKNOWN}"),
    (lambda: Spring(A, 1.0, to="x"), UNKNOWN),
    (lambda: Spring(A, 1.0, to=A), "both ends are the same joint"),
    (lambda: Spring(A, NAN), "stiffness of a spring bend must be finite"),
    (lambda: Spring(A, "stiff"), "must be a number, got 'stiff'"),  # type: ignore[arg-type]
    (lambda: Damper("x", 1.0), UNKNOWN),
    (lambda: Damper(A, 1.0, to=A), "both ends are the same joint"),
    (lambda: Damper(A, np.inf), "coefficient of a damper bend must be finite"),
    (lambda: Torque({"x": 1.0}), UNKNOWN),
    (lambda: Torque(law({"x": 1.0})), UNKNOWN),
    (lambda: Torque({A: NAN}), r"torque\['bend'\] must be finite, got nan"),
    (lambda: Torque(law([np.inf, 0, 0])), "torque at 'bend' must be finite, got inf"),
    (lambda: Torque(law([0, 1])), "must have 3 values, got 2"),
    (lambda: Torque(law(None)), "must have 3 values"),
    (lambda: Torque(law("abc")), "a CasADi SX expression, got str"),
    (lambda: Torque(law([MX] * 3)), "a CasADi SX expression, got MX"),
    (lambda: Torque(law({A: ca.SX.sym("z")})), "symbol 'z' that is none of t, x, xdot and mu"),
    (lambda: Torque(3), "torque must be a function"),  # type: ignore[arg-type]
    (lambda: Torque({A: 1.0}, limit=Limit(-1.0)), "finite and above zero, got -1"),
    (lambda: Torque({A: 1.0}, limit=Limit({B: 1.0})), "the limit of torque has no value for"),
    (lambda: Torque({A: 1.0}, limit=2.0), "limit: expected a Limit or None"),  # type: ignore[arg-type]
    (lambda: Torque({A: Linear([0, 0.1], [0, 1])}), "defined from 0 to 0.1 s, but the scene"),
    (lambda: Torque({A: Hold([0.1], [0])}), "defined from 0.1 to inf s"),
    (lambda: Torque({A: Expression("log(t-1)")}), "not finite at 80 of 80 random states"),
    (lambda: PD({"x": 1.0}, 1.0, 1.0), UNKNOWN),
    (lambda: PD({A: NAN}, 1.0, 1.0), r"pd\['bend'\] must be finite"),
    (lambda: PD({A: 1.0, B: 0.0}, {A: 1.0}, 1.0), "kp of pd has no value for 'sway'"),
    (lambda: PD({A: 1.0}, 1.0, NAN), "kd of pd must be finite"),
    (lambda: PD(3.0, 1.0, 1.0), "pd must have {joint: Signal or number}"),  # type: ignore[arg-type]
    (lambda: ComputedTorque({A: 1.0}, 1.0, 1.0), "no reference for joint 'sway'"),
    (lambda: PotentialEnergy(law(None)), "got NoneType"),
    (lambda: PotentialEnergy(law(NAN)), r"V\(x\) of potential must be finite"),
    (lambda: PotentialEnergy(lambda x: x), "must be one value"),
    (lambda: PotentialEnergy(3.0), "potential must be a function of x"),  # type: ignore[arg-type]
    (lambda: Wrench([0.0] * 5), "wrench must have 6 values, got 5"),
    (lambda: Wrench([NAN] * 6), r"wrench\[0\] must be finite"),
    (lambda: Wrench("abcdef"), "function: expected a function or"),  # type: ignore[arg-type]
    (lambda: Wrench(3.0), "wrench must be a function"),  # type: ignore[arg-type]
    (lambda: Controller(law([0]), 0.1, ("x",)), UNKNOWN),
    (lambda: Controller(law([0]), 0.0), "the period of controller must be finite and above zero"),
    (lambda: Controller(law([0]), NAN), "the period of controller must be finite"),
    (lambda: Controller(law([0]), 1e-13), "would call controller more than 1000000 times"),
    (lambda: Controller(law([0]), 0.1, "bend"), "must be a list of names"),  # type: ignore[arg-type]
    (lambda: Controller(law([0]), 0.1, (A, A)), "joints of controller must differ"),
    (lambda: Controller(3, 0.1), "controller must be a function"),  # type: ignore[arg-type]
    (lambda: "push", "forces: expected objects of pinred.forces, got 'push'"),
    (lambda: Spring, "forces: expected objects of pinred.forces"),
]


@pytest.mark.filterwarnings("ignore::FutureWarning")
@pytest.mark.parametrize(("make", "message"), BAD)
def test_invalid_forces_are_rejected(make: Callable[[], Any], message: str) -> None:
    """Before any integration."""
    with pytest.raises(pinred.InputError, match=message):
        pinred.simulate(CAT, duration=0.3, forces=[make()])


PLANS: list[tuple[dict[str, Any], str]] = [
    ({"prescribed": {"x": WAVE}}, UNKNOWN),
    ({"prescribed": {A: None}}, r"prescribed\['bend'\] must be a Signal, a number or a formula"),
    ({"prescribed": {A: True}}, r"prescribed\['bend'\] must be a Signal, a number or a formula"),
    ({"prescribed": {A: NAN}}, r"prescribed\['bend'\]: the value of a Constant must be one finite"),
    ({"prescribed": {A: "0.4*cos(x)"}}, r"prescribed\['bend'\]: the expression cannot be used"),
    ({"prescribed": {A: "abs(t)"}}, "has a kink or a jump"),
    ({"prescribed": [WAVE]}, "prescribed must be {joint: Signal, number or formula}"),
    ({"prescribed": {A: Hold([0.0], [0.0])}}, "has a kink or a jump; use a Spline"),
    ({"prescribed": {A: Linear([0.0, 1.0], [0.0, 1.0])}}, "has a kink or a jump; use a Spline"),
    ({"prescribed": {A: Expression("abs(t)")}}, "has a kink or a jump"),
    ({"prescribed": {A: Spline([0, 0.1, 0.2], [0, 1, 0])}}, "defined from 0 to 0.2 s"),
    ({"forces": 3}, "forces must be a list"),
    ({"springs": {A: 1.0}}, "stiffness, rest"),
    ({"springs": {A: (NAN, 0.0)}}, "both finite"),
    ({"outputs": "foo"}, "outputs must be one of all, shape, got 'foo'"),
    ({"method": pinred.RKMK4(0.01), "engine": "pinocchio"}, "SciPy's DOP853"),
    (
        {"forces": [ComputedTorque(dict.fromkeys(CAT.shape_names, 0.0), kp, 1.0) for kp in (1, 2)]},
        "only one force may depend on all others",
    ),
    (
        {"forces": [ComputedTorque({A: 0.0, B: 0.0, C: 0.0}, 1.0, 1.0)], "prescribed": {B: WAVE}},
        "has a reference for 'sway', which is prescribed",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("options", "message"), PLANS)
def test_invalid_options_are_rejected(options: dict[str, Any], message: str) -> None:
    """Before any integration."""
    with pytest.raises(pinred.InputError, match=message):
        pinred.simulate(CAT, duration=0.3, **options)


def test_computed_torque_rejects_gravity_moment_on_base() -> None:
    """There shape and momentum do not determine the accelerations."""
    swung = pinred.load("satellite_two_arms", group="SO3", gravity=(0, 0, -9.81))
    zero = dict.fromkeys(swung.shape_names, 0.0)
    with pytest.raises(pinred.SymmetryError, match="gravity rotates the base"):
        pinred.simulate(swung, seed=1, forces=[ComputedTorque(zero, 1.0, 1.0)])


def test_single_force_and_generator_of_forces_are_accepted() -> None:
    """A generator is read once."""
    spring = Spring(A, 5.0)
    listed = pinred.simulate(CAT, duration=0.3, forces=[spring])
    one: Any = spring
    np.testing.assert_array_equal(pinred.simulate(CAT, duration=0.3, forces=one).q, listed.q)
    scene = pinred.Scene(system=CAT, duration=0.3, forces=(f for f in [spring]))  # type: ignore[arg-type]
    np.testing.assert_array_equal(pinred.simulate(scene, rtol=1e-10).q, listed.q)


def test_barrier_force_stops_where_undefined() -> None:
    """The error has the time and the joint."""
    barrier = Torque(lambda _, x, *__: {A: 1e-3 * ca.log(0.3 - x[0] ** 2)})
    inside = pinred.simulate(CAT, x0=[0.1, 0.0, 0.0], duration=0.1, forces=[barrier])
    assert np.isfinite(inside.q).all()
    wide = Torque(lambda _, x, *__: {A: ca.sqrt(0.26 - x[0] ** 2)})
    with pytest.raises(pinred.IntegrationError, match=r"bend.*after t = 0\.01"):
        pinred.simulate(CAT, duration=0.3, forces=[wide])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"forces": [Controller(law([0.0] * 3), 0.1)]}, "controller is called every 0.1 s"),
        (
            {"prescribed": {A: Spline([0, 0.1, 0.3], [0, 1, 0])}},
            "a plan of a joint is not smooth at t = 0.1 s",
        ),
    ],
)
def test_batch_with_stops_runs_members_singly(
    options: dict[str, Any], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Members equal `simulate`, and `explain` states the reason."""
    many = pinred.simulate_many(CAT, seeds=range(2), duration=0.3, explain=True, **options)
    assert f"2 members one by one, DOP853: {message}" in " ".join(capsys.readouterr().out.split())
    for k in range(2):
        one = pinred.simulate(CAT, seed=k, duration=0.3, **options)
        np.testing.assert_array_equal(many[k].q, one.q)
        np.testing.assert_array_equal(many.x[k], one.x)


@pytest.mark.parametrize("torque", [WAVE, Hold([0, 0.1], [1, 2])])
@pytest.mark.sampled
def test_batch_with_smooth_plans_uses_lanes(torque: Any) -> None:
    """So do torques with breaks, from break to break."""
    options: dict[str, Any] = {
        "duration": 0.3, "prescribed": {A: WAVE}, "forces": [Torque({B: torque}), Damper(C, 0.1)]
    }  # fmt: skip
    many = pinred.simulate_many(CAT, seeds=range(2), **options)
    for k in range(2):
        one = pinred.simulate(CAT, seed=k, **options)
        np.testing.assert_allclose(many[k].q, one.q, rtol=0.0, atol=1e-12)


def test_results_without_base(tmp_path: Path) -> None:
    """Base quantities raise a helpful error; shape, energy and files work."""
    traj = pinred.simulate(CAT, duration=0.3, outputs="shape")
    names = ("xi", "pose", "q", "v", "states", "body_momentum", "energy_balance")
    for name in (*names, "momentum_balance"):
        with pytest.raises(pinred.InputError, match="simulate with outputs='all'"):
            getattr(traj, name)
    with pytest.raises(pinred.InputError, match="simulate with outputs='all'"):
        pinred.compare(traj)
    with pytest.raises(pinred.InputError, match="simulate with outputs='all'"):
        traj(0.1)
    traj.save(tmp_path / "x.npz")
    with np.load(tmp_path / "x.npz") as saved:
        origin = {"source", "lock_joints", "lock_values", "gravity"}
        assert set(saved) == {"robot", "group", "joints", "t", "x", "xdot", "energy"} | origin
        np.testing.assert_array_equal(saved["x"], traj.x)
    traj.save(tmp_path / "x.csv")
    head, *lines = (tmp_path / "x.csv").read_text().splitlines()
    assert head == "t,x.bend,x.sway,x.twist,xdot.bend,xdot.sway,xdot.twist,energy"
    table = np.array([line.split(",") for line in lines], dtype=float)
    np.testing.assert_array_equal(table[:, 1:4], traj.x)
    np.testing.assert_array_equal(table[:, 7], traj.energy)
