"""A flow in other people's languages: values and derivatives are the flow's own."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred import InputError, Parameter
from pinred.forces import Torque
from pinred.simulation.flow_map.flow import Flow


def flow_of(**options: Any) -> Flow:
    """Return a flow with a shape, a parameter of a body and one of a torque as inputs."""
    kick = Parameter("kick", 0.3)
    given = {
        "seed": 1, "duration": 0.3, "forces": [Torque({"bend": kick})], "method": "DOP853",
        "wrt": ["x0", "kick", "back.mass"], **options,
    }  # fmt: skip
    return pinred.flow(pinred.load("falling_cat"), **given)


AT = [np.array([0.4, 0.1, -0.2]), np.array([0.5]), np.array([2.1])]


@pytest.mark.parametrize("times", [None, [0.1, 0.3]])
def test_columns(times: Any) -> None:
    """Values of poses are their coordinates; differences and both modes agree."""
    columns = flow_of(times=times, rtol=1e-12).columns()
    jacobian = columns.jacobian(*AT)
    rng = np.random.default_rng(0)
    along = [rng.normal(size=size) for size in columns.sizes]
    forward = columns.jvp(AT, along)
    np.testing.assert_allclose(
        forward, sum(J @ v for J, v in zip(jacobian, along, strict=True)), atol=1e-12
    )
    low, high = (
        columns.value(*(a + s * 1e-4 * v for a, v in zip(AT, along, strict=True))) for s in (-1, 1)
    )
    np.testing.assert_allclose((high - low) / 2e-4, forward, atol=1e-5 * np.abs(forward).max())
    covector = rng.normal(size=columns.size)
    for found, J in zip(columns.vjp(AT, covector), jacobian, strict=True):
        np.testing.assert_allclose(found, covector @ J, atol=1e-11)


def test_casadi() -> None:
    """A Callback gives the flow and its Jacobian, also to what CasADi makes of it."""
    flow = flow_of()
    callback, columns = flow.casadi(), flow.columns()
    symbols = [ca.MX.sym(name, size) for name, size in zip("abc", columns.sizes, strict=True)]
    out = callback(*symbols)
    whole = ca.Function("whole", symbols, [out, ca.jacobian(out, ca.vertcat(*symbols))])
    value, slopes = whole(*AT)
    np.testing.assert_array_equal(np.array(value)[:, 0], columns.value(*AT))
    np.testing.assert_allclose(np.array(slopes), np.hstack(columns.jacobian(*AT)), atol=1e-14)


@pytest.mark.slow
def test_ipopt_finds_the_kick() -> None:
    """IPOPT finds the torque that brings a joint where it is wanted."""
    flow = flow_of(wrt=["kick"], of=["x"], rtol=1e-10)
    callback, kick = flow.casadi(), ca.MX.sym("kick")
    end = callback(kick)
    wanted = flow.columns().value(0.77)
    options: Any = {
        "ipopt.print_level": 0,
        "print_time": False,
        "ipopt.hessian_approximation": "limited-memory",
    }
    problem: Any = {"x": kick, "f": ca.sumsqr(end - wanted)}
    solver = ca.nlpsol("solver", "ipopt", problem, options)
    found = solver(x0=0.1)
    assert float(found["x"]) == pytest.approx(0.77, abs=1e-4)


@pytest.mark.slow
def test_jax() -> None:
    """Under jit, grad and vmap."""
    jax = pytest.importorskip("jax")
    flow = flow_of()
    function, columns = flow.jax(), flow.columns()
    np.testing.assert_allclose(jax.jit(function)(*AT), columns.value(*AT), atol=1e-14)
    jacobian = jax.jacrev(function, argnums=(0, 1, 2))(*AT)
    for found, expected in zip(jacobian, columns.jacobian(*AT), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-11)
    gradient = jax.jit(jax.grad(lambda x: (function(x, AT[1], AT[2]) ** 2).sum()))(AT[0])
    slopes = columns.vjp(AT, 2.0 * columns.value(*AT))[0]
    np.testing.assert_allclose(gradient, slopes, atol=1e-10)
    many = np.array([AT[0], AT[0] + 0.1])
    mapped = jax.vmap(function, in_axes=(0, None, None))(many, AT[1], AT[2])
    np.testing.assert_allclose(mapped[1], columns.value(many[1], *AT[1:]), atol=1e-14)


@pytest.mark.slow
def test_torch() -> None:
    """With autograd."""
    torch = pytest.importorskip("torch")
    flow = flow_of()
    function, columns = flow.torch(), flow.columns()
    tensors = [torch.tensor(a, requires_grad=True) for a in AT]
    out = function(*tensors)
    np.testing.assert_array_equal(out.detach().numpy(), columns.value(*AT))
    covector = torch.linspace(-1.0, 1.0, columns.size, dtype=torch.float64)
    (out @ covector).backward()
    for tensor, expected in zip(tensors, columns.vjp(AT, covector.numpy()), strict=True):
        np.testing.assert_allclose(tensor.grad.numpy(), expected, atol=1e-13)


def test_refusals() -> None:
    """What is no function between vectors is refused, and so are packages that are not there."""
    with pytest.raises(InputError, match="pose0 is a point of a group"):
        flow_of(wrt=["pose0"]).columns()
    with pytest.raises(InputError, match="no inputs with derivatives"):
        flow_of(wrt=[]).columns()
    for package, method in (("jax", flow_of().jax), ("torch", flow_of().torch)):
        try:
            __import__(package)
        except ImportError:
            with pytest.raises(pinred.MissingPackageError, match=f"pip install {package}"):
                method()
