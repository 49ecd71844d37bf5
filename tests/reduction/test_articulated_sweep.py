"""The symbolic sweep and the graphs made from it, against Pinocchio."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from strategies import Case, cases, make_case

import pinred
from pinred.common.arrays import Array
from pinred.kernels.kernel import Structure
from pinred.kernels.reduced_graph import ReducedGraph
from pinred.lie.rotations import rotation
from pinred.reduction.canonical_form import CanonicalForm
from pinred.reduction.cyclic_joints import cyclic_joints
from pinred.reduction.potential import shape_gravity
from pinred.reduction.tree.articulated_sweep import sweep
from pinred.reduction.tree.body_frames import bodies_of
from pinred.simulation.pinocchio_engine import PinocchioFlow
from pinred.simulation.plan import plan_of


def evaluate(function: ca.Function, *arguments: Array) -> Array:
    """Value of a CasADi function as a vector."""
    return np.array(function(*arguments)).ravel()


@pytest.mark.slow
@settings(max_examples=8)
@given(cases(0))
def test_sweep_random_momenta_solves_velocities_and_forces(case: Case) -> None:
    """H v = (μ, π) for any momentum, and π̇ of the canonical form, on every group."""
    system, r, m = case.system, case.system.r, case.system.m
    x = [ca.SX.sym(f"x{k}") for k in range(m)]
    pi = [ca.SX.sym(f"pi{k}") for k in range(m)]
    mu = [ca.SX.sym(f"mu{k}") for k in range(r)]
    found = sweep(bodies_of(system), x, pi, mu, system.group.axes, 0.0, {})
    xi = [[*found.root_linear, *found.root_angular][axis] for axis in system.group.axes]
    function = ca.Function(
        "f",
        [ca.vertcat(*x), ca.vertcat(*pi), ca.vertcat(*mu)],
        [ca.vertcat(*xi, *found.xdot), ca.vertcat(*found.pidot)],
    )
    H = pinred.Reduction(system).mass_matrix(case.x)
    p = H @ case.v
    v, force = (np.array(out).ravel() for out in function(case.x, p[r:], p[:r]))
    scale = np.linalg.cond(H) * np.finfo(float).eps * 20
    np.testing.assert_allclose(v, case.v, rtol=0, atol=max(1e-12, scale) * np.abs(case.v).max())
    if m:
        expected = CanonicalForm(system, shape_gravity(system)).force(case.x, case.v)
        size = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(force, expected, rtol=0, atol=max(1e-12, scale) * size)


@pytest.mark.slow
@settings(max_examples=8)
@given(cases(1))
def test_body_frames_have_joint_axis_along_z(case: Case) -> None:
    """At random shapes, bodies in their frames have Pinocchio's placements and inertias."""
    bodies = bodies_of(case.system)
    total = sum(body.mass for body in bodies)
    assert total == pytest.approx(case.system.mass, rel=1e-14)
    graph = ReducedGraph(case.system, Structure())
    com = ca.Function("com", [ca.vertcat(*graph.x)], [ca.vertcat(*graph.com())])
    expected = pinred.Reduction(case.system).at(case.x).com
    np.testing.assert_allclose(evaluate(com, case.x), expected, atol=1e-13)


@pytest.mark.parametrize("zero", [True, False])
@pytest.mark.parametrize(
    "name", ["elroys_beanie", "coupled_planar", "planar_chain5", "rigid_body", "coupled_spatial",
             "satellite_two_arms", "falling_cat", "cartpole", "double_spherical_pendulum",
             "reaction_wheel_satellite"],
)  # fmt: skip
@pytest.mark.sampled(3)
def test_reduced_graph_rates_equal_pinocchio_route(name: str, zero: bool) -> None:
    """The graph of every bundled robot gives the rates of the readable route."""
    system = pinred.load(name)
    springs = {system.shape_names[0]: (2.0, 0.3)} if system.m else {}
    state = pinred.Scene(system=system).start
    options = {"momentum": 0.0} if zero else {"xi0": state.xi}
    if not system.m and zero:
        options = {"momentum": np.zeros(system.r)}
    scene = pinred.Scene(
        system=system,
        x0=state.x,
        xdot0=state.xdot,
        springs=springs,
        **options,
    )
    flow = PinocchioFlow(plan_of(scene))
    structure = plan_of(scene).structure(zero_momentum=zero)
    graph = ReducedGraph(system, structure, scene.force_model)
    layout, m = graph.layout, system.m
    active, cyclic = list(layout.active), list(layout.cyclic)
    y0, base = flow.y0, flow.base
    assert base.spin.any() != zero or not base.spin.size
    y = np.concatenate([y0[:m][active], y0[m : 2 * m][active], y0[:m][cyclic], y0[2 * m :]])
    gravity = plan_of(scene).gravity[list(layout.gravity)]
    parameters = np.concatenate([base.spin, y0[m : 2 * m][cyclic], gravity, flow.parameters])
    assert (len(y), len(parameters)) == (layout.size, layout.parameters)
    rate = flow.rate(0.0, y0)
    expected = np.concatenate(
        [rate[:m][active], rate[m : 2 * m][active], rate[:m][cyclic], rate[2 * m :]]
    )
    found = evaluate(graph.rate(), y, parameters)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * max(1, np.abs(rate).max()))


def test_graph_of_planar_robot_has_few_operations() -> None:
    """Zeros fold away: a planar joint costs a fraction of a spatial one, a cyclic one none."""
    sizes = {
        name: ReducedGraph(pinred.load(name), Structure(zero_momentum=False))
        .rate()
        .n_instructions()
        for name in ("coupled_planar", "planar_chain5", "coupled_spatial")
    }
    assert sizes["coupled_planar"] < 60
    assert sizes["planar_chain5"] < 400
    assert sizes["planar_chain5"] / 5 < sizes["coupled_spatial"] / 3


def test_reaction_wheels_are_not_integrated() -> None:
    """Three reaction wheels leave three numbers instead of six: their angles, as quadratures."""
    system = pinred.load("reaction_wheel_satellite")
    cyclic = cyclic_joints(pinred.Reduction(system))
    assert [system.shape_names[k] for k in cyclic] == ["wheel_x", "wheel_y", "wheel_z"]
    layout = ReducedGraph(system, Structure(zero_momentum=False, cyclic=cyclic)).layout
    assert (layout.size, layout.parameters) == (2 + 3 + 4, 3 + 3)
    free = ReducedGraph(system, Structure(zero_momentum=False)).layout
    assert (free.size, free.parameters) == (2 * 4 + 4, 3)
    sprung = pinred.Reduction(system, springs={"wheel_y": (1.0, 0.0)})
    assert [system.shape_names[k] for k in cyclic_joints(sprung)] == ["wheel_x", "wheel_z"]


def test_unbalanced_wheel_is_not_cyclic() -> None:
    """The inertia depends on the angle of a wheel that is a millionth out of balance."""
    system = pinred.load("reaction_wheel_satellite")
    k = system.shape_names.index("wheel_x") + 2
    inertia = system.model.inertias[k]
    inertia.lever = inertia.lever + np.array([0.0, 1e-6, 0.0])
    system.model.inertias[k] = inertia
    assert "wheel_x" not in [system.shape_names[j] for j in cyclic_joints(pinred.Reduction(system))]


def test_rates_depend_on_attitude_through_body_momentum_only() -> None:
    """With momentum, only the direction of J in the body enters, for a quaternion of any length."""
    case = make_case("SO3", 2, 5)
    graph = ReducedGraph(case.system, Structure(zero_momentum=False))
    rng = case.rng
    y, q, J = rng.normal(size=graph.layout.size), case.pose, rng.normal(size=3)
    y[-4:] = q
    found = evaluate(graph.rate(), y, J)
    y[-4:] = 3.0 * q
    longer = evaluate(graph.rate(), y, J)
    np.testing.assert_allclose(longer[:-4], found[:-4], rtol=1e-13)
    np.testing.assert_allclose(longer[-4:], 3.0 * found[-4:], rtol=1e-13)
    H = pinred.Reduction(case.system).mass_matrix(y[:2])
    v = np.linalg.solve(H, np.concatenate([rotation(q).T @ J, y[2:4]]))
    np.testing.assert_allclose(found[:2], v[3:], rtol=1e-11)
