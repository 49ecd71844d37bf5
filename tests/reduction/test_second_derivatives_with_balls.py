"""Second derivatives along the frame, Levi-Civita connection and curvature of robots with balls."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree, joined_bodies, random_body

import pinred
from pinred.common.arrays import Array
from pinred.reduction.tree.second_derivatives import inertia_derivatives
from pinred.system.robot_file_contents import Contents, Coupling
from pinred.system.system import System

SIX = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))  # weights of differences of order six
NINE = np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 840.0  # of order eight


def coupled_tree() -> System:
    """Return a tree with hinges before and behind a ball, of which one follows the other."""
    model, rng = pin.Model(), np.random.default_rng(4)
    parent = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.gravity.setZero()
    model.appendBodyToJoint(parent, *random_body(rng))
    for k, kind in enumerate((pin.JointModelRX, pin.JointModelSpherical, pin.JointModelRY)):
        place = pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3))
        parent = model.addJoint(parent, kind(), place, f"j{k}")
        model.appendBodyToJoint(parent, *random_body(rng))
    return System(model, contents=Contents(couplings=(Coupling("j2", {"j0": 0.7}, 0.2),)))


@pytest.mark.parametrize("robot", ["SE3", "SO3", "SE2", "coupled"])
def test_second_derivatives_along_frame_equal_differences_of_pinocchio(robot: str) -> None:
    """H, c and first derivatives by Pinocchio; e_a e_b H by differences along e_a of e_b H."""
    system = coupled_tree() if robot == "coupled" else ball_tree(3, 5, robot)
    x, n, r = system.space.random(np.random.default_rng(0), 1.5), system.n, system.r
    found, red = inertia_derivatives(system, x[None]), pinred.Reduction(system)
    model, data = system.sorted_model, system.sorted_model.createData()

    def slope(at: Array) -> Array:
        q, out = system.sorted_q(system.group.identity(), at), np.empty((n, n, system.m))
        for k, e in enumerate(np.eye(n)):
            zero = np.zeros(model.nv)
            d = pin.computeRNEADerivatives(model, data, q, zero, system.joint_rates(e))[0]
            out[:, k] = system.coupled_matrix(d)[:, r:]
        return out

    size, split = np.abs(found.H).max(), red.split(x)
    np.testing.assert_allclose(found.H[0], split.mass_matrix, atol=1e-13 * size)
    np.testing.assert_allclose(found.com[0], split.com, atol=1e-14)
    np.testing.assert_allclose(found.dH[0], slope(x), atol=1e-13 * size)
    np.testing.assert_allclose(found.dcom[0], red.com_slope(x), atol=1e-13)
    for a, unit in enumerate(np.eye(system.m)):
        twice, turned = np.zeros((n, n, system.m)), np.zeros((3, system.m))
        for k, weight in SIX:
            ahead, behind = (system.space.integrate(x, s * k * 1e-3 * unit) for s in (1.0, -1.0))
            twice += weight / 1e-3 * (slope(ahead) - slope(behind))
            turned += weight / 1e-3 * (red.com_slope(ahead) - red.com_slope(behind))
        np.testing.assert_allclose(found.d2H[0, :, :, a], twice, atol=1e-10 * size)
        np.testing.assert_allclose(found.d2com[0, :, a], turned, atol=1e-10)
    for d, d2 in ((found.dH[0], found.d2H[0]), (found.dcom[0], found.d2com[0])):
        commutator = d2 - np.swapaxes(d2, -1, -2)
        expected = np.einsum("gab,...g->...ab", system.space.structure, d)
        np.testing.assert_allclose(commutator, expected, atol=1e-13 * size)


def test_derivatives_of_selected_rates_equal_all_derivatives() -> None:
    """Columns of selected rates, at many shapes at once."""
    system, rng = ball_tree(4, 4), np.random.default_rng(1)
    x = np.array([system.space.random(rng, 2.0) for _ in range(3)])
    full, part = inertia_derivatives(system, x), inertia_derivatives(system, x, of={1, 4})
    for c in (system.r + 1, system.r + 4):
        np.testing.assert_array_equal(part.dH[:, : c + 1, c], full.dH[:, : c + 1, c])
        np.testing.assert_array_equal(part.d2H[:, : c + 1, c], full.d2H[:, : c + 1, c])
    np.testing.assert_array_equal(part.d2com, full.d2com)


@pytest.mark.parametrize("group", ["SE3", "SO3", "SE2"])
def test_christoffel_symbols_in_frame_have_no_torsion_and_keep_metric(group: str) -> None:
    """Γ_ab − Γ_ba = c_ab, and e_aM_bc = ⟨∇_a e_b, e_c⟩ + ⟨e_b, ∇_a e_c⟩."""
    system = ball_tree(7, 4, group)
    x, red = system.space.random(np.random.default_rng(2), 2.0), pinred.Reduction(system)
    symbols, at = red.christoffel(x), red.at(x)
    size = np.abs(symbols).max()
    torsion = symbols - np.swapaxes(symbols, 1, 2)
    np.testing.assert_allclose(torsion, system.space.structure, atol=1e-12 * size)
    lowered = np.einsum("cd,dab->abc", at.reduced_metric, symbols)
    expected = lowered + np.swapaxes(lowered, 1, 2)
    np.testing.assert_allclose(
        np.moveaxis(at.dM, 2, 0), expected, atol=1e-12 * np.abs(lowered).max()
    )


@pytest.mark.parametrize("group", ["SE3", "SO3", "SE2"])
def test_aba_of_balls_at_zero_momentum_has_no_covariant_acceleration(group: str) -> None:
    """The motion of ABA at zero momentum is a geodesic."""
    system, rng = ball_tree(8, 5, group), np.random.default_rng(3)
    red, x, sigma = (
        pinred.Reduction(system),
        system.space.random(rng, 2.0),
        rng.normal(size=system.m),
    )
    v = np.concatenate([-red.local_connection(x) @ sigma, sigma])
    q = system.sorted_q(system.group.identity(), x)
    a = np.array(
        pin.aba(system.sorted_model, system.sorted_model.createData(), q, v, np.zeros(system.n))
    )
    rest = red.covariant_acceleration(x, sigma, a[system.r :])
    size = np.abs(red.christoffel(x)).max() * np.abs(sigma).max() ** 2
    assert np.abs(rest).max() <= 1e-12 * size


def test_simulated_motion_of_ball_at_zero_momentum_is_geodesic() -> None:
    """Two bodies without momentum: σ̇ by differences of the simulated rates."""
    system = joined_bodies()
    traj = pinred.simulate(
        system, xdot0=[0.6, -0.9, 0.4], momentum=0, duration=1.6, engine="pinocchio", rtol=1e-11
    )
    red = pinred.Reduction(system)
    for t in (0.5, 1.5):
        states = traj(t + 2e-3 * np.arange(-4, 5))
        sigmadot = NINE / 2e-3 @ states.xdot
        rest = red.covariant_acceleration(states.x[4], states.xdot[4], sigmadot)
        assert np.abs(rest).max() < 1e-8
        assert np.abs(sigmadot).max() > 1e-2


def pivoted_ball(inertia: float, moments: Array) -> System:
    """Return a spherical body on a pivot, and a body on a ball at the same point.

    Then A = R J / (inertia + J), and M = inertia J / (inertia + J) is left-invariant.
    """
    model = pin.Model()
    model.gravity.setZero()
    place = pin.SE3.Identity()
    root = model.addJoint(0, pin.JointModelSpherical(), place, "root")
    model.appendBodyToJoint(root, pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3)), place)
    ball = model.addJoint(root, pin.JointModelSpherical(), place, "ball")
    model.appendBodyToJoint(ball, pin.Inertia(1.0, np.zeros(3), np.diag(moments)), place)
    return System(model)


@pytest.mark.parametrize("moments", [(1.0, 1.0, 1.0), (0.6, 0.8, 1.1)])
def test_left_invariant_metric_on_rotations_has_curvature_of_milnor(
    moments: tuple[float, float, float],
) -> None:
    """K(e_1, e_2) = λ_3 μ_3 − μ_1 μ_2 for [e_2, e_3] = λ_1 e_1 …, μ_i = ½ Σλ − λ_i (Milnor 1976).

    For the bi-invariant metric M = a it is ¼ |[u, v]|² = 1/(4a).
    """
    system = pivoted_ball(2.0, np.array(moments))
    red, rng = pinred.Reduction(system), np.random.default_rng(5)
    x = system.space.random(rng, 2.0)
    M = 2.0 * np.array(moments) / (2.0 + np.array(moments))
    np.testing.assert_allclose(red.reduced_metric(x), np.diag(M), atol=1e-14)
    lam = M / np.sqrt(M.prod())
    half = 0.5 * lam.sum() - lam
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        u, v = np.eye(3)[i], np.eye(3)[j] + 0.3 * np.eye(3)[i]
        found = red.sectional_curvature(x, u, v)
        assert found == pytest.approx(lam[k] * half[k] - half[i] * half[j], rel=1e-12)
        if M[0] == M[1] == M[2]:
            assert found == pytest.approx(1.0 / (4.0 * M[0]), rel=1e-12)


def test_curvature_of_ball_equals_curvature_in_euler_angles() -> None:
    """The same robot with a ball and with three hinges has the same sectional curvatures."""

    def robot(joint: pin.JointModel) -> System:
        model, rng = pin.Model(), np.random.default_rng(6)
        model.gravity.setZero()
        root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
        model.appendBodyToJoint(root, *random_body(rng))
        place = pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3))
        ball = model.addJoint(root, joint, place, "ball")
        model.appendBodyToJoint(ball, *random_body(rng))
        hinge = model.addJoint(ball, pin.JointModelRX(), place, "hinge")
        model.appendBodyToJoint(hinge, *random_body(rng))
        return pinred.load(model)

    angles, rng = np.array([0.4, -0.5, 0.7]), np.random.default_rng(7)
    with pytest.warns(pinred.ModelWarning, match="singular at single shapes"):
        euler = robot(pin.JointModelSphericalZYX())
    ball = robot(pin.JointModelSpherical())
    assert (euler.nx, euler.m, ball.nx, ball.m) == (4, 4, 5, 4)
    Rz, Ry, Rx = (pin.exp3(a * e) for a, e in zip(angles, np.eye(3)[::-1], strict=True))
    q = pin.Quaternion(Rz @ Ry @ Rx).coeffs()
    E = np.eye(4)  # rates of the angles to rates along the ball's axes
    E[:3, :3] = np.column_stack([(Ry @ Rx).T[:, 2], Rx.T[:, 1], np.eye(3)[0]])
    first, second = pinred.Reduction(euler), pinred.Reduction(ball)
    y, x = np.append(angles, 0.3), np.append(q, 0.3)
    M = first.reduced_metric(y)
    np.testing.assert_allclose(E.T @ second.reduced_metric(x) @ E, M, atol=1e-14)
    R = np.einsum("abcd,ai,bj,ck,dl->ijkl", second.riemann(x), E, E, E, E)
    expected = first.riemann(y)
    np.testing.assert_allclose(R, expected, atol=1e-12 * np.abs(expected).max())
    u, v = rng.normal(size=(2, 4))
    assert second.sectional_curvature(x, E @ u, E @ v) == pytest.approx(
        first.sectional_curvature(y, u, v), rel=1e-11
    )
