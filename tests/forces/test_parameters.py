"""Parameters: named numbers in forces and signals."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred import InputError, Parameter
from pinred.forces import PD, Damper, Friction, Limit, PotentialEnergy, Spring, Torque
from pinred.signals import Constant, Fourier, Hold, Linear, Spline

CAT = pinred.load("falling_cat")


def end(forces: Any = (), prescribed: Any = None, **options: Any) -> Any:
    """Return the state at the end of a short motion."""
    traj = pinred.simulate(
        CAT, duration=0.5, forces=forces, prescribed=prescribed or {}, **options
    )  # fmt: skip
    return np.concatenate([traj.x[-1], traj.xdot[-1], traj.pose[-1]])


def two_equal_values(k: Any) -> list[Any]:
    """Return a table that starts and ends with one value."""
    return [k, 0.2, k]


@pytest.mark.parametrize(
    "make",
    [
        lambda k: {"forces": [Spring("bend", k, 0.1)]},
        lambda k: {"forces": [Spring("bend", 1.0, k, polynomial=(0.1, k))]},
        lambda k: {"forces": [Damper("bend", k, polynomial=(k,)), Friction("sway", k, k)]},
        lambda k: {"forces": [PD({"bend": k}, kp={"bend": k}, kd=k, limit=Limit(k))]},
        lambda k: {"forces": [Torque(lambda *s: {"bend": k * s[1][0] - s[1][1] / k + k**2})]},
        lambda k: {"forces": [Torque({"bend": k, "sway": lambda *_: ca.sin(k) - (1.0 - k)})]},
        lambda k: {"forces": [PotentialEnergy(lambda x: k * ca.cos(x["bend"]))]},
        lambda k: {"forces": [Torque({"bend": Hold([0.0, 0.2], [k, 0.1])})]},
        lambda k: {"forces": [Torque({"bend": Linear([0.0, 0.2, 1.0], [k, 0.1, k])})]},
        lambda k: {"prescribed": {"bend": Constant(k)}},
        lambda k: {"prescribed": {"bend": Fourier(k, [0.1, k], [k], k)}},
        lambda k: {
            "prescribed": {"bend": Spline([0.0, 0.3, 1.0], two_equal_values(k), end="periodic")}
        },
    ],
)
@pytest.mark.sampled(4)
def test_parameter_equals_its_number(make: Any) -> None:
    """In every place where a number is allowed, the motion is equal."""
    number = end(**make(0.7))
    np.testing.assert_allclose(end(**make(Parameter("k", 0.7))), number, rtol=1e-7, atol=1e-9)
    other = end(**make(Parameter("k", 0.5)), parameters={"k": 0.7})
    np.testing.assert_allclose(other, number, rtol=1e-7, atol=1e-9)
    assert np.abs(end(**make(Parameter("k", 0.5))) - number).max() > 1e-6


def test_signals_use_parameter_values() -> None:
    """A signal evaluated alone has the values of its parameters."""
    plan = Fourier(Parameter("mean", 0.3), [Parameter("a", 0.5)], [], 2.0)
    assert plan.value(0.0) == 0.8
    values: list[float | Parameter] = [Parameter("a", 0.5), 1.0]
    assert Spline([0.0, 1.0], values).value(0.5) == 0.75


def test_invalid_parameters_are_rejected() -> None:
    """The message lists the valid names."""
    with pytest.raises(InputError, match="name of a Parameter must be text, got 3"):
        Parameter(3, 1.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="'k' must be a finite number, got nan"):
        Parameter("k", float("nan"))
    with pytest.raises(InputError, match="'k' must be a finite number, got 'a'"):
        Parameter("k", "a")  # type: ignore[arg-type]
    one, two = Parameter("k", 1.0), Parameter("k", 1.0)
    with pytest.raises(InputError, match="two Parameters have the name 'k'"):
        end([Spring("bend", one), Damper("bend", two)])
    with pytest.raises(InputError, match=r"no 'gian'; did you mean 'gain'\? .* here are gain"):
        end([Spring("bend", Parameter("gain", 1.0))], parameters={"gian": 2.0})
    with pytest.raises(InputError, match="here are none"):
        end(parameters={"gain": 2.0})
    with pytest.raises(InputError, match=r"parameters\['gain'\] must be finite"):
        end([Spring("bend", Parameter("gain", 1.0))], parameters={"gain": np.inf})
    with pytest.raises(InputError, match="there is no 'gain'"):
        end(parameters=["gain"])
    with pytest.raises(InputError, match="parameters must be"):
        end(parameters=3)
    with pytest.raises(InputError, match="must not be negative, got -1"):
        Friction("bend", Parameter("most", -1.0), 0.1)


def test_parameter_survives_pickling() -> None:
    """A copy in another process has the same name and value."""
    gain = Parameter("gain", 2.0)
    _ = gain.symbol
    for other in (pickle.loads(pickle.dumps(gain)), copy.deepcopy(gain)):
        assert (other.name, other.value) == ("gain", 2.0)
        assert other.symbol.element_hash() != gain.symbol.element_hash()


def test_scene_files_define_parameters(tmp_path: Any) -> None:
    """A scene file may name numbers for its formulas."""
    path = tmp_path / "scene.toml"
    text = """robot = "falling_cat"
[parameters]
gain = 2.0
[[forces]]
kind = "torque"
function = { bend = "-gain*x['bend']" }
"""
    path.write_text(text)
    scene = pinred.load_scene(path)
    assert [parameter.name for parameter in scene.force_model.parameters] == ["gain"]  # type: ignore[union-attr]
    path.write_text(text.replace("gain = 2.0", "t = 2.0"))
    with pytest.raises(pinred.InputError, match="t: must be a name"):
        pinred.load_scene(path)


@pytest.mark.parametrize("count", [10, 40])
@pytest.mark.sampled
def test_table_of_parameters_passes_kernel_validation(count: int) -> None:
    """A kernel of steep pieces is validated at reasonable numbers."""
    knots = [Parameter(f"knot {k}", 0.1 * (-1) ** k) for k in range(count)]
    times = np.linspace(0.0, 1.0, count + 2)
    plan = {"bend": Spline(times, [0.0, *knots, 0.0], end="clamped")}
    traj = pinred.simulate(pinred.load("falling_cat"), prescribed=plan, momentum=0, duration=1.0)
    np.testing.assert_allclose(traj(float(times[3])).x[0], knots[2].value, atol=1e-9)


def test_parameters_in_springs_and_prescribed_joints() -> None:
    """Times of tables cannot be parameters, because they define breaks."""
    cat = pinred.load("falling_cat")
    options: dict[str, Any] = {"seed": 1, "duration": 0.2, "times": [0.2]}

    def moved(k: Any, s: Any, **more: Any) -> Any:
        return pinred.simulate(
            cat, springs={"bend": (k, 0.1), "twist": (1.0, k)}, prescribed={"sway": s}, **options,
            **more,
        ).q  # fmt: skip

    k, s = Parameter("k", 1.0), Parameter("s", 0.3)
    state = moved(k, s, parameters={"k": 2.5, "s": -0.2})
    np.testing.assert_array_equal(state, moved(2.5, -0.2))
    # Another Parameter of the same name and value is another one.
    np.testing.assert_array_equal(moved(Parameter("k", 1.0), s, parameters={"k": 2.5}),
                                  moved(2.5, 0.3))  # fmt: skip
    with pytest.raises(InputError, match="times of a Linear define its breaks"):
        pinred.signals.Linear([0.0, k, 2.0], [0.0, 1.0, 0.0])  # type: ignore[arg-type]
    with pytest.raises(pinred.ShapeError, match="must be numbers, got '2'"):
        pinred.Scene(system=cat, seed=1, parameters={"back.mass": "2"})
