"""The Jacobian by recursion, against CasADi's differentiation of the equations."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from trees import limbed_model

import pinred
from pinred.common.errors import KernelMismatch
from pinred.forces import PD, Torque, Wrench
from pinred.kernels import build as graphs
from pinred.kernels.build import jacobian_code, jacobian_of
from pinred.kernels.kernel import Kernel
from pinred.kernels.reduced_graph import ReducedGraph
from pinred.reduction.tree.articulated_sweep import sweep_jacobian
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.plan import plan_of


def kernel_of(system: pinred.System, **options: Any) -> Kernel:
    """Return the kernel of a scene."""
    return CompiledFlow.of_plan(plan_of(pinred.Scene(system=system, seed=1, **options))).kernel


def require_equal_jacobians(kernel: Kernel) -> None:
    """Compare the compiled recursion with CasADi's derivatives of the equations without lanes."""
    assert graphs.has_recursion(kernel.system, kernel.structure, kernel.forces)
    rate = ReducedGraph(kernel.system, kernel.structure, kernel.forces).rate()
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    plain = ca.Function("plain", [y, p], [ca.densify(ca.jacobian(rate(y, p), y))])
    rng = np.random.default_rng(2)
    for _ in range(2):
        at, parameters = rng.normal(size=y.numel()), kernel.random_parameters(rng)
        expected = np.array(plain(at, parameters))
        found = jacobian_of(kernel, at, parameters)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


# SE3-2 contains their terms.
@pytest.mark.by_hand("SO3-3", "SE2-4", "R-2")
@pytest.mark.parametrize(
    ("group", "limbs"), [("SE3", 2), ("SO3", 3), ("SE2", 4), ("SO2", 1), ("R", 2)]
)
def test_recursion_on_random_trees_equals_casadi(group: str, limbs: int) -> None:
    """Hinges and slides, with identical branches in lanes, on roots of all kinds."""
    require_equal_jacobians(kernel_of(pinred.load(limbed_model(group, limbs, 2, 1))))


def test_recursion_with_armature_gravity_and_forces_equals_casadi() -> None:
    """The chain rule through forces, a base wrench, gravity on a pivot, and cyclic joints."""
    system = pinred.load("satellite_two_arms")
    first = system.shape_names[0]
    forces = [
        PD({first: 0.3}, kp=2.0, kd=0.1),
        Torque(lambda t, x, xdot, mu: {first: -0.1 * t * mu[-1] * x[0] * xdot[0]}),
        Wrench(lambda t, x, xdot, mu: [0.1 * x[0], 0.0, 0.2 * t, 0.0, 0.3 * xdot[0], 0.1 * mu[3]]),
    ]
    require_equal_jacobians(kernel_of(system, forces=forces))
    for name in ("double_spherical_pendulum", "reaction_wheel_satellite", "cartpole"):
        require_equal_jacobians(kernel_of(pinred.load(name)))


def test_other_structures_use_columns() -> None:
    """Prescribed joints, balls, couplings and loops: `has_recursion` is false."""
    for name in ("diver", "four_bar"):
        kernel = kernel_of(pinred.load(name))
        assert not graphs.has_recursion(kernel.system, kernel.structure, kernel.forces)
    system = pinred.load("falling_cat")
    kernel = kernel_of(system, prescribed={"sway": 0.2})
    assert not graphs.has_recursion(kernel.system, kernel.structure, kernel.forces)


@pytest.mark.by_hand("0.0")
@pytest.mark.parametrize("scale", [1.0 + 1e-5, 0.0])
def test_wrong_recursion_is_rejected(
    scale: float, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """An error of 1e-5 in the derivatives of the sweep is detected when the code is built."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path_factory.mktemp("cache", numbered=True)))
    right = sweep_jacobian

    def wrong(*arguments: Any) -> Any:
        rows = right(*arguments)
        rows[-1] = [entry * scale for entry in rows[-1]]
        return rows

    kernel = kernel_of(pinred.load("falling_cat"))
    monkeypatch.setattr(graphs, "sweep_jacobian", wrong)
    with pytest.raises(KernelMismatch, match="column"):
        jacobian_code(kernel)
