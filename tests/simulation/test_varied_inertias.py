"""Inertias of bodies as inputs of the kernel: values, derivatives and rejected values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred import InputError
from pinred.kernels import build
from pinred.system.body_parameters import Bodies
from pinred.system.model_parameters import ModelParameters

VALUES: dict[str, dict[str, Any]] = {
    "falling_cat": {
        "back.mass": 2.5,
        "back.com": [0.1, 0.0, 0.2],
        "spine2.payload.mass": 0.3,
        "spine2.payload.at": [0.1, 0.2, 0.3],
        "front.inertia": [0.02, 0.001, 0.0, 0.025, 0.002, 0.03],
    },
    "planar_chain5": {
        "link2.mass": 1.5, "link3.payload.mass": 0.4, "link3.payload.at": [0.1, 0.2, 0.0],
    },
    "cartpole": {"pole.mass": 2.0, "pole.com": [0.1, 0.0, 0.7], "cart.mass": 1.5},
    "satellite_two_arms": {"left_hand.mass": 3.0, "bus.com": [0.1, 0.0, 0.1]},
}  # fmt: skip


@pytest.mark.by_hand
@pytest.mark.parametrize("name", [*VALUES])
def test_other_inertias_agree_with_aba(name: str) -> None:
    """Pinocchio changes the inertias of its own model."""
    system, values = pinred.load(name), VALUES[name]
    traj = pinred.simulate(system, seed=1, duration=0.2, parameters=values)
    report = pinred.compare(traj)
    assert report.passed, report
    model, other = system.model, traj.system.model
    words = Bodies(system, list(values))
    for each in words.parameters:
        own, new = model.inertias[each.body + 1], other.inertias[each.body + 1]
        if each.kind == "payload.mass":
            at = values[each.name.replace(".mass", ".at")]
            load = pin.Inertia(values[each.name], np.array(at, dtype=float), np.zeros((3, 3)))
            own = own + load
            np.testing.assert_allclose(new.matrix(), own.matrix(), atol=1e-14)
        elif each.kind in ("mass", "com"):
            found = new.mass if each.kind == "mass" else new.lever
            np.testing.assert_allclose(found, values[each.name], rtol=1e-14)
    flow = pinred.flow(system, seed=1, duration=0.2, wrt=[*values])
    states: Any = flow(**values)
    np.testing.assert_allclose(states.x, traj.x[-1], rtol=0, atol=1e-7)
    np.testing.assert_allclose(states.pose, traj.pose[-1], rtol=0, atol=1e-7)


@pytest.mark.by_hand
@pytest.mark.parametrize("name", [*VALUES])
def test_derivatives_by_inertias_agree_with_differences(name: str) -> None:
    """The adjoint agrees with the tangent."""
    flow = pinred.flow(
        pinred.load(name), seed=1, duration=0.3, wrt=[*VALUES[name]], rtol=1e-12, method="DOP853"
    )
    values = VALUES[name]
    jacobian = flow.jacobian(**values)
    covector = np.random.default_rng(0).normal(size=len(jacobian[next(iter(values))]))
    for key, found in flow.vjp(covector, **values).items():
        expected = covector @ jacobian[key]
        np.testing.assert_allclose(found, expected, atol=1e-11 * max(1, np.abs(expected).max()))
    for key, value in values.items():
        v = np.random.default_rng(1).normal(size=np.shape(value)) * 1e-5
        low, high = (flow(**{**values, key: np.add(value, s * v)}) for s in (-1, 1))
        for row in ("x", "xdot"):
            expected = (getattr(high, row) - getattr(low, row)) / 2e-5
            slopes = jacobian[key][flow.outputs[row]]
            found = np.reshape(slopes, (len(expected), -1)) @ np.ravel(v) / 1e-5
            np.testing.assert_allclose(found, expected, atol=3e-6 * max(1, np.abs(found).max()))


def test_log_cholesky_parameters_are_physical() -> None:
    """The ten parameters reproduce the inertia, and any ten give a physical one."""
    system = pinred.load("falling_cat")
    bodies = Bodies(system, ["back.log_cholesky"])
    same = ModelParameters(system, ["back.log_cholesky"]).system(bodies.own()).model.inertias[4]
    np.testing.assert_allclose(same.matrix(), system.model.inertias[4].matrix(), atol=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(20):
        theta = rng.normal(size=10)
        total, slopes = bodies.dynamic(3, {"back.log_cholesky": theta})
        v = 1e-6 * rng.normal(size=10)
        low, high = (
            bodies.dynamic(3, {"back.log_cholesky": theta + s * v})[0] for s in (-1.0, 1.0)
        )
        size = np.abs(total).max()
        expected = slopes["back.log_cholesky"] @ v
        np.testing.assert_allclose((high - low) / 2.0, expected, atol=1e-9 * size)


def test_new_inertias_reuse_the_kernel(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Several masses and centres of mass take one kernel."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))
    made: list[str] = []
    whole: Any = vars(build)["compile_object"]

    def counted(function: Any, name: str, *args: Any, **options: Any) -> Any:
        made.append(name)
        return whole(function, name, *args, **options)

    monkeypatch.setattr(build, "compile_object", counted)
    chain = pinred.load("planar_chain5")
    ends = []
    for mass in np.linspace(0.5, 2.0, 6):
        traj = pinred.simulate(
            chain, seed=1, duration=0.05, times=[0.05], rtol=1e-6,
            parameters={"link2.mass": mass, "link2.com": [mass, 0.0, 0.0]},
        )  # fmt: skip
        ends.append(traj.x[-1])
    assert made == ["rate", "outputs"]
    assert len(np.unique(ends, axis=0)) == 6
    again = pinred.Scene(system=traj.system, seed=1, duration=0.05)
    assert again.parameters["link2.mass"] == 2.0  # a system keeps what it was given


def test_wheel_with_variable_centre_is_not_cyclic() -> None:
    """A joint is cyclic only if all values of the parameters keep it cyclic."""
    system = pinred.load("reaction_wheel_satellite")
    cyclic = {
        name: pinred.flow(system, wrt=[name], duration=0.1).propagator.kernel.structure.cyclic
        for name in ("wheel_x.mass", "wheel_x.com", "wheel_y.inertia")
    }
    assert cyclic == {
        "wheel_x.mass": (1, 2, 3), "wheel_x.com": (2, 3), "wheel_y.inertia": (1, 3),
    }  # fmt: skip


def test_unphysical_inertias_are_rejected() -> None:
    """Unphysical values and unknown names are rejected by name."""
    cat = pinred.load("falling_cat")

    def refused(match: str, **options: Any) -> None:
        with pytest.raises(InputError, match=match):
            pinred.Scene(system=cat, seed=1, **options)

    refused("no link or joint 'bak'; did you mean 'back'", parameters={"bak.mass": 1.0})
    refused("'back.mass' must be above zero, got 0", parameters={"back.mass": 0.0})
    refused("'back.payload.mass' must not be negative", parameters={"back.payload.mass": -1.0})
    wrong = [1.0, 0.0, 0.0, 1.0, 0.0, 3.0]
    refused("'back.inertia' is not physical", parameters={"back.inertia": wrong})
    refused(r"parameters\['back.com'\] must have shape", parameters={"back.com": [1.0]})
    refused(
        "belong to the same body", parameters={"back.mass": 1.0, f"{cat.model.names[4]}.mass": 1.0}
    )
    refused(
        "sets all parameters of a body. Omit 'back.mass'",
        parameters={"back.mass": 1.0, "back.log_cholesky": np.zeros(10)},
    )


def test_inputs_are_copied() -> None:
    """Changing an array after a call does not change the derivatives of that call."""
    system = pinred.load("planar_chain5")
    name = f"{system.shape_names[2]}.com"
    flow, anew = (pinred.flow(system, seed=1, duration=0.2, wrt=[name]) for _ in range(2))
    given = flow.own(name) + 0.05
    flow(**{name: given})
    same = given.copy()
    given[:2] += 1.0
    found, expected = flow.jacobian(**{name: same})[name], anew.jacobian(**{name: same})[name]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)
    assert np.abs(expected).max() > 1e-6
