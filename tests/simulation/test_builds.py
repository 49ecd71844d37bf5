"""Numbers are inputs of a kernel: however often they change, it is built once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pinred
from pinred import Parameter
from pinred.forces import PD, ComputedTorque, Damper, Friction, Limit, Spring, Torque, Wrench
from pinred.kernels import build
from pinred.signals import Constant, Fourier, Hold, Linear, Spline

GAIN, BIAS = Parameter("gain", 1.0), Parameter("bias", 0.1)


def feedback(_t: Any, x: Any, xdot: Any, _mu: Any) -> Any:
    """Return a torque with constants that vary."""
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
    "computed torque": lambda v: {
        "forces": [
            ComputedTorque(
                {"bend": Fourier(0.0, [v / 9], [], 2.0), "sway": 0.0, "twist": 0.1}, kp=9 * v, kd=6
            )
        ]
    },
}  # fmt: skip


@pytest.fixture
def builds(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of all functions that are compiled, in an empty cache."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))
    made: list[str] = []
    whole: Callable[..., bytes] = vars(build)["compile_object"]

    def counted(function: Any, name: str, *args: Any, **options: Any) -> bytes:
        made.append(name)
        return whole(function, name, *args, **options)

    monkeypatch.setattr(build, "compile_object", counted)
    return made


@pytest.mark.parametrize(
    "kind",
    [k if k != "computed torque" else pytest.param(k, marks=pytest.mark.slow) for k in SCENES],
)
def test_one_build_for_a_hundred_numbers(kind: str, builds: list[str]) -> None:
    """Every coefficient of a force or signal takes a hundred values with one kernel."""
    cat = pinred.load("falling_cat")
    ends = []
    for value in np.linspace(0.5, 1.5, 100):
        options = SCENES[kind](float(value))
        traj = pinred.simulate(cat, duration=0.1, times=[0.1], rtol=1e-6, atol=1e-8, **options)
        ends.append(np.concatenate([traj.x[-1], traj.xdot[-1], traj.pose[-1]]))
    assert builds == ["rate", "outputs"]
    assert len(np.unique(ends, axis=0)) == 100  # and each value counts


def test_one_build_for_a_hundred_gravities(builds: list[str]) -> None:
    """Gravity that acts on the shape is an input; where it acts not at all is another structure."""
    ends = [
        pinred.simulate(pinred.load("cartpole", gravity=(0, 0, -g)), duration=0.1, times=[0.1]).x[
            -1
        ]
        for g in np.linspace(0.5, 20.0, 100)
    ]
    assert builds == ["rate", "outputs"]
    assert len(np.unique(ends, axis=0)) == 100
    pinred.simulate(pinred.load("cartpole", gravity=(0, 0, 0)), duration=0.1)
    assert len(builds) == 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["constants of expressions", "formula", "spline"])
def test_numbers_count_as_they_are(kind: str) -> None:
    """Numbers that came to a kernel as inputs give the motion that Pinocchio's ABA does."""
    cat = pinred.load("falling_cat")
    for value in (0.8, 1.3):  # the second one takes the kernel of the first
        traj = pinred.simulate(cat, duration=0.2, **SCENES[kind](value))
    report = pinred.compare(traj)
    assert report.passed, report
