"""One step of a flow as a map, against ABA with short Runge–Kutta steps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred import InputError, Parameter
from pinred.common.arrays import Array
from pinred.forces import Torque
from pinred.signals import Hold

H = 0.02
NAMES = ("u0", "u1", "u2")


def flow_of(method: str = "DOP853", **options: Any) -> pinred.Flow:
    """Return the flow of a cat with three torques, one of which grows with time."""
    a, b, c = (Parameter(name, 0.1 * (k + 1)) for k, name in enumerate(NAMES))
    law = Torque(lambda t, *_: {"bend": a * (1.0 + t), "sway": b, "twist": c})
    given = {"seed": 1, "duration": 0.5, "forces": [law], "wrt": NAMES, "method": method}
    return pinred.flow(pinred.load("falling_cat"), **{**given, **options})


def by_aba(system: pinred.System, state: Any, u: Array, t: float, count: int) -> tuple[Any, Any]:
    """Return q and v after H by the classical Runge–Kutta method on ABA, in tangents of q."""
    model, h = system.model, H / count
    data, nv = model.createData(), model.nv
    q, v = system.q(state.pose, state.x), system.v(state.xi, state.xdot)

    def rate(q0: Any, z: Any, time: float) -> Any:
        there = pin.integrate(model, q0, z[:nv])
        tau = np.append(np.zeros(6), [u[0] * (1.0 + time), u[1], u[2]])
        turned = np.linalg.solve(pin.dIntegrate(model, q0, z[:nv])[1], z[nv:])
        return np.append(turned, pin.aba(model, data, there, z[nv:], tau))

    for k in range(count):
        z, now = np.append(np.zeros(nv), v), t + k * h
        k1 = rate(q, z, now)
        k2 = rate(q, z + 0.5 * h * k1, now + 0.5 * h)
        k3 = rate(q, z + 0.5 * h * k2, now + 0.5 * h)
        k4 = rate(q, z + h * k3, now + h)
        z = z + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        q, v = pin.integrate(model, q, z[:nv]), z[nv:]
    return q, v


@pytest.mark.by_hand("Gauss(0.02)-0.3")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "t"),
    [
        pytest.param("DOP853", 0.0, marks=pytest.mark.by_hand),
        ("DOP853", 0.3),
        ("Gauss(0.02)", 0.3),
    ],
)
def test_step_and_jacobians_agree_with_aba(method: str, t: float) -> None:
    """From any time, the Jacobians F_x and F_u agree with differences."""
    flow = flow_of(method)
    step, system, start = flow.step(H), flow.system, flow.scene.start
    u = np.array([0.3, 0.2, 0.3])
    found = step.linear(start, t=t, **dict(zip(NAMES, u.tolist(), strict=True)))
    q, v = by_aba(system, start, u, t, 40)
    short = 1.0 if method == "DOP853" else 30.0  # of four stages, where DOP853 has twelve
    np.testing.assert_allclose(found.state.q, q, rtol=0, atol=1e-11 * short)
    np.testing.assert_allclose(found.state.v, v, rtol=0, atol=1e-10 * short)
    group, r, m = system.group, system.r, system.m
    jacobian = np.hstack([found.by_state, found.by_parameters])
    assert jacobian.shape == (step.ndx, step.ndx + step.nu)
    assert step.outputs == flow.outputs  # the same order, so that slices fit both
    h = 1e-4
    for k in range(jacobian.shape[1]):
        ends = []
        for sign in (-h, h):
            d = np.zeros(jacobian.shape[1])
            d[k] = sign
            dx, dxdot, eta, dxi, du = np.split(d, np.cumsum([m, m, r, r]))
            state = SimpleNamespace(
                pose=group.compose(start.pose, group.exp(eta)),
                x=start.x + dx, xdot=start.xdot + dxdot, xi=start.xi + dxi,
            )  # fmt: skip
            q, v = by_aba(system, state, u + du, t, 10)
            ends.append((system.configuration(q), system.velocity(v)))
        (low, slow), (high, fast) = ends
        turned = group.log(group.compose(group.inverse(low.pose), high.pose))
        parts = [high.x - low.x, fast.xdot - slow.xdot, turned, fast.xi - slow.xi]
        np.testing.assert_allclose(jacobian[:, k], np.concatenate(parts) / (2.0 * h), atol=1e-6)


def test_consecutive_steps_agree_with_simulate() -> None:
    """25 steps from State to State agree with the motion."""
    flow = flow_of("DOP853", rtol=1e-12)
    step, state = flow.step(H), flow.scene.start  # type: Any, Any
    for k in range(25):
        state = step(state, t=k * H)
    end: Any = flow()
    for name in ("x", "xdot", "pose", "xi"):
        np.testing.assert_allclose(getattr(state, name), getattr(end, name), rtol=0, atol=5e-9)
    assert state.t == pytest.approx(0.5)
    falling = pinred.flow(
        pinred.load("satellite_two_arms", gravity=(0, 0, -9.8)), seed=1, duration=1
    )
    state = falling.scene.start
    fall, end = falling.step(0.1), falling()
    for k in range(10):
        state = fall(state, t=0.1 * k)
    np.testing.assert_allclose(state.pose, end.pose, rtol=0, atol=1e-7)


def test_invalid_steps_are_rejected() -> None:
    """Steps over breaks, outside the scene, or from invalid states are rejected."""
    step = flow_of().step(H)
    assert step.parameters == dict.fromkeys(NAMES, 1)
    assert "falling_cat" in repr(step)
    with pytest.raises(InputError, match="takes x0 in the state"):
        step(x0=[0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="takes a State, with pose"):
        step([0.0])
    with pytest.raises(InputError, match="no input 'u9'; its inputs are"):
        step(u9=0.0)
    with pytest.raises(InputError, match=r"not within the scene's 0\.5 s"):
        step(t=0.49)
    with pytest.raises(InputError, match="t: expected a time"):
        step(t=float("nan"))
    with pytest.raises(InputError, match="h must be"):
        flow_of().step(0.0)
    with pytest.raises(InputError, match="needs the base"):
        pinred.flow(pinred.load("falling_cat"), seed=1, outputs="shape").step(H)
    table = Torque({"bend": Hold([0.0, 0.25], [0.1, 0.2])})
    steps = flow_of(forces=[table], wrt=[]).step(0.1)
    with pytest.raises(InputError, match=r"not smooth at t = 0\.25 s, within the step"):
        steps(t=0.2)
    planned = flow_of(forces=[], wrt=[], prescribed={"bend": "0.1*sin(t)"}).step(0.1)
    planned()
    with pytest.raises(InputError, match="prescribed joints begins at t = 0"):
        planned(t=0.1)
