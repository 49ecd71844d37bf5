"""Kernels take parameters as inputs, so new values compile and cache nothing new."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pinred
from pinred import Parameter
from pinred.forces import PD, ComputedTorque, Damper, Friction, Limit, Spring, Torque, Wrench
from pinred.kernels import build, differentiable, initial_conditions
from pinred.signals import Constant, Fourier, Hold, Linear, Spline

GAIN, BIAS = Parameter("gain", 1.0), Parameter("bias", 0.1)


PUSH = Wrench([0.1, 0.2, 0.3], link="back", at=[0.1, 0.0, 0.2])
HELD = ComputedTorque({"bend": 0.5, "sway": 0.2, "twist": 0.1}, kp=9.0, kd=6.0)


def feedback(_t: Any, x: Any, xdot: Any, _mu: Any) -> Any:
    """Return a torque with variable constants."""
    return {"bend": -GAIN * x["bend"] + BIAS * xdot[1]}


SCENES: dict[str, Callable[[float], dict[str, Any]]] = {
    "spring": lambda v: {"forces": [Spring("bend", v, 0.1 * v, polynomial=(0.2 * v,))]},
    "damper": lambda v: {"forces": [Damper("bend", v), Friction("sway", 0.1 * v, 0.3 * v)]},
    "gains and limits": lambda v: {
        "forces": [PD({"bend": v}, kp=2.0 * v, kd=0.1 * v, limit=Limit(5.0 * v, smooth=True))]
    },
    "constants of expressions": lambda v: {
        "forces": [
            Torque(feedback),
            Wrench([BIAS, 0.0, 0.0, 0.0, 0.0, GAIN]),
        ],
        "parameters": {"gain": v, "bias": 0.1 * v},
    },
    "series": lambda v: {"prescribed": {"bend": Fourier(0.1 * v, [0.2 * v], [0.1], 1.0 + 0.1 * v)}},
    "formula": lambda v: {"prescribed": {"bend": f"{v:.6f}*sin({2 * v:.6f}*t) + t**2"}},
    "locked by a plan": lambda v: {"prescribed": {"bend": 0.3 * v, "sway": Constant(-0.1 * v)}},
    "spline": lambda v: {
        "prescribed": {"bend": Spline([0.0, 0.1 * v, 1.0], [0.1, v, 0.0], end="clamped")}
    },
    "tables": lambda v: {
        "forces": [Torque({"bend": Linear([0, v / 9, 1], [0, v, 0]), "sway": Hold([0], [v / 9])})]
    },
    "mass": lambda v: {"parameters": {"back.mass": v, "front.mass": 2.0 * v}},
    "centre and moments": lambda v: {
        "parameters": {"back.com": [v, 0.1, 0.0], "front.inertia": [v, 0.0, 0.0, v, 0.0, v]}
    },
    "payload": lambda v: {
        "parameters": {"front.payload.mass": v, "front.payload.at": [0.1 * v, 0.2, 0.3]}
    },
    "log-Cholesky": lambda v: {"parameters": {"front.log_cholesky": [0.1 * v] * 10}},
    "length of a link": lambda v: {"parameters": {"twist.translation": [0.0, 0.0, v]}},
    "any placement": lambda v: {
        "parameters": {"sway.placement": [0.1, 0.2 * v, 0.3, 0.2 * v, -0.3, 0.4]}
    },
    "computed torque": lambda v: {
        "forces": [
            ComputedTorque(
                {"bend": Fourier(0.0, [v / 9], [], 2.0), "sway": 0.0, "twist": 0.1}, kp=9 * v, kd=6
            )
        ]
    },
    "beside a wrench on a link": lambda v: {
        "forces": [PUSH],
        "parameters": {"twist.placement": [0.1, 0.2 * v, 0.3, 0.2 * v, -0.3, 0.4], "back.mass": v},
    },
    "beside computed torque": lambda v: {
        "forces": [HELD],
        "parameters": {"sway.translation": [0.1, 0.2 * v, 0.3], "back.com": [v, 0.1, 0.0]},
    },
}  # fmt: skip
SLOW = ("computed torque", "beside a wrench on a link", "beside computed torque")


@pytest.fixture
def builds(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of functions compiled for single runs in a test, with an empty cache."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))
    made: list[str] = []
    whole: Callable[..., bytes] = vars(build)["compile_object"]

    def counted(function: Any, name: str, *args: Any, **options: Any) -> bytes:
        if "wide" not in options:
            made.append(name)
        return whole(function, name, *args, **options)

    for module in (build, initial_conditions, differentiable):
        monkeypatch.setattr(module, "compile_object", counted)
    return made


def entries(folder: Any) -> int:
    """Return the number of files in a cache."""
    return sum(1 for file in folder.rglob("*") if file.is_file())


@pytest.mark.by_hand
@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=pytest.mark.slow) if k in SLOW else k for k in SCENES],
)
def test_new_force_and_signal_values_reuse_the_kernel(
    kind: str, builds: list[str], tmp_path: Any
) -> None:
    """Every coefficient of a force, signal or body takes a hundred values with one kernel."""
    cat = pinred.load("falling_cat")
    ends, stored = [], []
    for value in np.linspace(0.5, 1.5, 100):
        options = SCENES[kind](float(value))
        traj = pinred.simulate(cat, duration=0.1, times=[0.1], rtol=1e-6, atol=1e-8, **options)
        ends.append(np.concatenate([traj.x[-1], traj.xdot[-1], traj.pose[-1]]))
        stored.append(entries(tmp_path))
    assert sorted(builds) == ["initial_conditions", "outputs", "rate"]
    assert stored[0] == stored[-1]
    assert len(np.unique(ends, axis=0)) == 100  # and each value counts


def test_new_lock_values_reuse_the_kernel(builds: list[str]) -> None:
    """The value of a locked joint is an input, and each value changes the motion."""
    cat = pinred.load("falling_cat", lock={"sway": 0.3})
    ends = [
        pinred.simulate(cat, seed=1, duration=0.1, times=[0.1], parameters={"sway.lock": value}).xi
        for value in np.linspace(0.2, 1.2, 12)
    ]
    assert sorted(builds) == ["initial_conditions", "outputs", "rate"]
    assert len(np.unique(np.ravel(ends)[::6])) == 12
    again = pinred.simulate(
        pinred.load("falling_cat", lock={"sway": 1.2}), seed=1, duration=0.1, times=[0.1]
    )
    np.testing.assert_allclose(again.xi, ends[-1], rtol=0, atol=1e-11)


def test_new_flow_inputs_reuse_the_kernels(builds: list[str], tmp_path: Any) -> None:
    """Flows take masses, placements and gravity as inputs."""
    pole = pinred.load("cartpole")
    names = {"pole.mass": 1.0, "pole_pivot.translation": 0.5, "gravity.strength": 9.0}
    flow = pinred.flow(pole, seed=1, duration=0.1, wrt=[*names], method="DOP853")
    ends, stored = [], []
    for v in np.linspace(0.5, 1.5, 100):
        values: dict[str, Any] = {n: v * size for n, size in names.items()}
        values["pole_pivot.translation"] = [v, 0.1 * v, 0.0]
        ends.append(flow(**values).x)
        stored.append(entries(tmp_path))
    assert len(builds) == len(set(builds))
    assert stored[0] == stored[-1]
    assert len(np.unique(ends, axis=0)) == 100


def test_new_gravity_values_reuse_the_kernel(builds: list[str]) -> None:
    """Gravity that acts on the shape is an input; without gravity the kernel is another."""
    ends = [
        pinred.simulate(pinred.load("cartpole", gravity=(0, 0, -g)), duration=0.1, times=[0.1]).x[
            -1
        ]
        for g in np.linspace(0.5, 20.0, 7)
    ]
    assert sorted(builds) == ["initial_conditions", "outputs", "rate"]
    assert len(np.unique(ends, axis=0)) == 7
    cartpole = pinred.load("cartpole")
    by_name = [
        pinred.simulate(cartpole, duration=0.1, times=[0.1], parameters={"gravity.strength": g}).x[
            -1
        ]
        for g in np.linspace(0.5, 20.0, 7)
    ]
    np.testing.assert_array_equal(by_name, ends)
    assert len(builds) == 3
    pinred.simulate(pinred.load("cartpole", gravity=(0, 0, 0)), duration=0.1)
    assert len(builds) == 5  # the initial conditions are those of before


@pytest.mark.slow
def test_new_robots_under_computed_torque_reuse_the_kernels(builds: list[str]) -> None:
    """Members and flows take masses, placements and gravity as inputs under computed torque."""
    pole, values = pinred.load("cartpole"), np.linspace(0.5, 1.5, 100)
    forces = [ComputedTorque({"pole_pivot": 0.3}, kp=9.0, kd=6.0)]
    numbers = {
        "pole.mass": values,
        "pole_pivot.translation": np.outer(values, [1.0, 0.1, 0.0]),
        "gravity": np.outer(values, [0.0, 0.0, -9.0]),
    }
    options: dict[str, Any] = {"duration": 0.1, "times": [0.1], "seed": 1, "forces": forces}
    many = pinred.simulate_many(pole, members=numbers, method="DOP853", **options)
    assert sorted(builds) == ["initial_conditions", "outputs", "rate"]
    assert np.ptp(many.x[:, -1]) < 1e-11  # whatever they are, it is held
    assert len(np.unique(many.xi[:, -1], axis=0)) == 100
    flow = pinred.flow(pole, wrt=[*numbers], method="DOP853", **options)
    made = len(builds)
    for k in range(0, 100, 9):
        end: Any = flow(**{name: column[k] for name, column in numbers.items()})
        np.testing.assert_allclose(end.xi[0], many.xi[k, -1], rtol=0, atol=1e-9)
    assert len(builds) <= made + 1  # the begin of a flow


@pytest.mark.by_hand
@pytest.mark.parametrize("kind", ["constants of expressions", "formula", "spline"])
def test_reused_kernel_agrees_with_aba(kind: str) -> None:
    """A kernel compiled for other values gives the motion of Pinocchio's ABA."""
    cat = pinred.load("falling_cat")
    for value in (0.8, 1.3):  # the second one takes the kernel of the first
        traj = pinred.simulate(cat, duration=0.2, **SCENES[kind](value))
    report = pinred.compare(traj)
    assert report.passed, report
