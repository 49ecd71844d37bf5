"""Tests of the axioms of all groups, also near the identity and near half turns."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from trees import climbing_joint

from pinred import InputError, ShapeError
from pinred.common.arrays import Array
from pinred.lie import GROUPS, SE2, SE3, SO2, SO3, Group, R, RxSE2, group_named
from pinred.lie.rotations import hat, left_jacobian, left_jacobian_inverse

ALL = list(GROUPS.values())
SIZES = [0.0, 1e-300, 1e-16, 1e-12, 1e-8, 1e-5, 1e-4, 1e-3, 0.0999, 0.1001, 1.0, 3.0]
NEAR_HALF_TURN = [np.pi - gap for gap in (1e-3, 1e-8, 1e-12, 0.0)]

groups = st.sampled_from(ALL)
seeds = st.integers(0, 2**32 - 1)


def algebra_matrix(group: Group, xi: Array) -> Array:
    """Return ξ as a matrix: the derivative of the homogeneous matrix at the identity."""
    v, w = np.split(spatial_twist(group, xi), 2)
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = hat(w), v
    # The matrix is that of SE(3) without the directions along which the group never moves.
    moving = {axis for axis in group.axes if axis < 3}
    for axis in group.axes[group.linear :]:
        moving |= {0, 1, 2} - {axis - 3}
    kept = [*sorted(moving), *([3] if group.linear else [])]
    return matrix[np.ix_(kept, kept)]


def spatial_twist(group: Group, xi: Array) -> Array:
    """Return a twist of the group as a twist of SE(3), (6,)."""
    whole = np.zeros(6)
    whole[list(group.axes)] = xi
    return whole


def random_twist(group: Group, rng: np.random.Generator, turn: float = 1.5) -> Array:
    """Draw a random twist whose rotation has norm `turn` at most."""
    xi = rng.uniform(-1.0, 1.0, group.dim)
    w = xi[group.linear :]
    if w.size:
        w *= turn / max(1.0, float(np.linalg.norm(w)))
    return xi


def is_same_pose(group: Group, g: Array, h: Array, tolerance: float = 1e-13) -> bool:
    """Return whether two poses are the same group element."""
    return bool(np.abs(group.matrix(g) - group.matrix(h)).max() <= tolerance)


@given(groups, seeds)
def test_group_satisfies_the_axioms(group: Group, seed: int) -> None:
    """Identity, inverse and associativity hold, and the matrix is a homomorphism."""
    rng = np.random.default_rng(seed)
    a, b, c = (group.exp(random_twist(group, rng, 3.0)) for _ in range(3))
    e = group.identity()
    assert is_same_pose(group, group.compose(a, e), a)
    assert is_same_pose(group, group.compose(e, a), a)
    assert is_same_pose(group, group.compose(a, group.inverse(a)), e)
    left = group.compose(group.compose(a, b), c)
    assert is_same_pose(group, left, group.compose(a, group.compose(b, c)))
    product = group.matrix(a) @ group.matrix(b)
    np.testing.assert_allclose(group.matrix(group.compose(a, b)), product, atol=1e-14)
    assert is_same_pose(group, group.from_matrix(group.matrix(a)), a)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("group", ALL, ids=repr)
def test_log_inverts_exp_to_round_off(group: Group, size: float) -> None:
    """log(exp ξ) equals ξ to round-off, however small ξ is."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        xi = rng.normal(size=group.dim)
        xi *= size / np.linalg.norm(xi)
        back = group.log(group.exp(xi))
        np.testing.assert_allclose(back, xi, rtol=0.0, atol=4e-15 * size)


@pytest.mark.parametrize("turn", NEAR_HALF_TURN)
@pytest.mark.parametrize("group", [group for group in ALL if group.turns], ids=repr)
def test_log_near_half_turn_returns_at_most_pi(group: Group, turn: float) -> None:
    """Near and at half a turn, log returns the rotation angle, at most π."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        xi = rng.normal(size=group.dim)
        w = xi[group.linear :]
        w *= turn / np.linalg.norm(w)
        back = group.log(group.exp(xi))
        angle = np.linalg.norm(back[group.linear :])
        assert angle == pytest.approx(turn, abs=1e-14)
        assert angle <= np.pi + 1e-15
        assert is_same_pose(group, group.exp(back), group.exp(xi), 1e-14)


@given(groups, seeds, st.sampled_from([1e-9, 1e-4, 0.05, 0.15, 1.0, 3.1]))
def test_exp_equals_matrix_exponential(group: Group, seed: int, turn: float) -> None:
    """Exp, Ad, ad and the bracket agree with SciPy's expm and matrix products."""
    rng = np.random.default_rng(seed)
    xi, eta = random_twist(group, rng, turn), random_twist(group, rng)
    g = group.exp(xi)
    M, X, Y = group.matrix(g), algebra_matrix(group, xi), algebra_matrix(group, eta)
    np.testing.assert_allclose(M, expm(X), atol=2e-14)
    transformed = algebra_matrix(group, group.Ad(g) @ eta)
    np.testing.assert_allclose(transformed, M @ Y @ np.linalg.inv(M), atol=1e-13)
    bracket = algebra_matrix(group, group.bracket(xi, eta))
    np.testing.assert_allclose(bracket, X @ Y - Y @ X, atol=1e-14)
    np.testing.assert_allclose(group.ad(xi) @ eta, group.bracket(xi, eta), atol=1e-15)
    np.testing.assert_allclose(group.Ad(g), expm(group.ad(xi)), atol=1e-13)


@pytest.mark.parametrize("turn", [1e-9, 1e-3, 0.05, 0.0999, 0.1001, 0.5, 3.0])
def test_left_jacobian_equals_power_series(turn: float) -> None:
    """V(ω) = Σ ωᵏ/(k + 1)! to round-off on both sides of the switch to its series, and V⁻¹."""
    w = turn * np.array([0.48, -0.6, 0.64])
    series, power = np.eye(3), np.eye(3)
    for k in range(1, 40):
        power = power @ hat(w) / (k + 1.0)
        series = series + power
    np.testing.assert_allclose(left_jacobian(w), series, rtol=0.0, atol=2e-15)
    np.testing.assert_allclose(left_jacobian_inverse(w) @ series, np.eye(3), rtol=0.0, atol=2e-15)


@pytest.mark.parametrize("group", [group for group in ALL if group.turns == 3], ids=repr)
def test_normalize_scales_quaternion_to_unit_norm(group: Group) -> None:
    """The direction of the quaternion stays, for any initial norm."""
    g = group.exp(np.linspace(0.2, 0.7, group.dim))
    for length in (0.5, 1.0 + 1e-7, 3.0):
        longer = g.copy()
        longer[-4:] *= length
        np.testing.assert_allclose(group.normalize(longer), g, rtol=1e-15)
    nearly = g.copy()
    nearly[-4:] *= 1.0 + 5e-7  # a typical rounding error in files
    assert np.linalg.norm(group.pose(nearly)[-4:]) == pytest.approx(1.0, abs=1e-15)


@given(groups, seeds)
def test_bracket_equals_bracket_of_se3(group: Group, seed: int) -> None:
    """The axes are closed under the bracket of se(3), and both brackets are equal."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, group.dim))
    whole = pin.Motion(spatial_twist(group, a)).cross(pin.Motion(spatial_twist(group, b))).vector
    np.testing.assert_allclose(spatial_twist(group, group.bracket(a, b)), whole, atol=1e-15)


@given(groups, seeds)
def test_linear_and_angular_parts_equal_those_of_se3(group: Group, seed: int) -> None:
    """Linear parts rotate as Ad does; the angular part about a point is that of SE(3)."""
    rng = np.random.default_rng(seed)
    g, k = group.exp(random_twist(group, rng, 3.0)), group.linear
    v = rng.normal(size=k)
    np.testing.assert_allclose(group.turned(g[k:], v), group.Ad(g)[:k, :k] @ v, atol=1e-14)
    np.testing.assert_allclose(group.turned_back(g[k:], group.turned(g[k:], v)), v, atol=1e-14)
    c, mu = rng.normal(size=3), rng.normal(size=group.dim)
    shifted = pin.SE3(np.eye(3), c).actInv(pin.Force(spatial_twist(group, mu))).vector
    expected = shifted[list(group.axes[k:])]
    np.testing.assert_allclose(group.about(c, mu), expected, atol=1e-14)


@pytest.mark.parametrize("group", ALL, ids=repr)
def test_names_and_sizes_are_consistent(group: Group) -> None:
    """Each coordinate of a pose and of a twist has a distinct name."""
    assert len(set(group.pose_names)) == len(group.identity()) == group.size
    assert len(set(group.twist_names)) == group.dim == group.linear + group.turns
    assert group.linear == sum(name.startswith("v") for name in group.twist_names)
    assert repr(group) == group.name
    assert GROUPS[group.name] is group
    assert group.is_pivot == (group is SO3)


@given(groups, seeds)
def test_momentum_pairing_is_invariant(group: Group, seed: int) -> None:
    """⟨J, Ad_g ξ⟩ = ⟨μ, ξ⟩, ⟨ad*_ξ μ, η⟩ = ⟨μ, [ξ, η]⟩, and Jacobi's identity."""
    rng = np.random.default_rng(seed)
    g, mu = group.exp(random_twist(group, rng, 3.0)), rng.normal(size=group.dim)
    x, y, z = (random_twist(group, rng) for _ in range(3))
    J = group.spatial_momentum(g, mu)
    assert J @ group.Ad(g) @ x == pytest.approx(mu @ x, abs=1e-13)
    assert group.coadjoint(x, mu) @ y == pytest.approx(mu @ group.bracket(x, y), abs=1e-14)
    b = group.bracket
    cyclic = b(x, b(y, z)) + b(y, b(z, x)) + b(z, b(x, y))
    np.testing.assert_allclose(cyclic, np.zeros(group.dim), atol=1e-14)


@given(groups, seeds)
def test_rate_equals_pose_derivative(group: Group, seed: int) -> None:
    """ġ = g ξ, compared with differences of order six of g exp(ξ t)."""
    rng = np.random.default_rng(seed)
    g, xi, h = group.exp(random_twist(group, rng)), random_twist(group, rng), 1e-3
    weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    slope = np.zeros(group.size)
    for k, w in weights.items():
        ahead, behind = (group.compose(g, group.exp(s * k * h * xi)) for s in (1, -1))
        slope += w * (ahead - behind) / h
    np.testing.assert_allclose(group.rate(g, xi), slope, atol=1e-11)


@given(seeds)
def test_exp_log_and_products_equal_pinocchio(seed: int) -> None:
    """Pinocchio computes exp, log and products with independent formulas."""
    rng = np.random.default_rng(seed)
    xi, eta = random_twist(SE3, rng, 2.5), random_twist(SE3, rng, 2.5)
    g, h = SE3.exp(xi), SE3.exp(eta)
    M, N = pin.exp6(pin.Motion(xi)), pin.exp6(pin.Motion(eta))
    np.testing.assert_allclose(SE3.matrix(g), M.homogeneous, atol=1e-13)
    np.testing.assert_allclose(SE3.log(g), pin.log6(M).vector, atol=1e-11)
    np.testing.assert_allclose(SE3.Ad(g), M.action, atol=1e-13)
    both = SE3.matrix(SE3.compose(g, h))
    np.testing.assert_allclose(both, (M * N).homogeneous, atol=1e-13)
    np.testing.assert_allclose(SE3.ad(xi) @ eta, pin.Motion(xi).cross(pin.Motion(eta)).vector)
    np.testing.assert_allclose(SO3.matrix(SO3.exp(xi[3:])), pin.exp3(xi[3:]), atol=1e-13)
    planar = np.array([xi[0], xi[1], xi[5]])
    x, y, c, s = pin.liegroups.SE2().integrate(np.array([0.0, 0.0, 1.0, 0.0]), planar)
    np.testing.assert_allclose(SE2.exp(planar), [x, y, np.arctan2(s, c)], atol=1e-13)
    climbing, model = np.append(xi[2], planar), pin.Model()
    model.addJoint(0, climbing_joint(), pin.SE3.Identity(), "root")
    q = pin.integrate(model, pin.neutral(model), climbing)
    np.testing.assert_allclose(RxSE2.exp(climbing), [*q[:3], np.arctan2(q[4], q[3])], atol=1e-13)


@pytest.mark.parametrize("group", ALL, ids=repr)
def test_operation_on_stack_equals_loop(group: Group) -> None:
    """Each operation on a stack equals that operation on each element."""
    rng = np.random.default_rng(3)
    xi, eta = rng.uniform(-1, 1, (2, 4, 3, group.dim))
    g, h = group.exp(xi), group.exp(eta)
    stacked = {
        "compose": group.compose(g, h), "inverse": group.inverse(g), "exp": g,
        "log": group.log(g), "Ad": group.Ad(g), "ad": group.ad(xi), "matrix": group.matrix(g),
        "rate": group.rate(g, xi), "bracket": group.bracket(xi, eta),
        "coadjoint": group.coadjoint(xi, eta), "spatial_momentum": group.spatial_momentum(g, xi),
        "normalize": group.normalize(g), "from_matrix": group.from_matrix(group.matrix(g)),
    }  # fmt: skip
    arguments = {
        "compose": (g, h), "rate": (g, xi), "bracket": (xi, eta), "coadjoint": (xi, eta),
        "spatial_momentum": (g, xi), "exp": (xi,), "ad": (xi,), "from_matrix": (group.matrix(g),),
    }  # fmt: skip
    for name, whole in stacked.items():
        for i in np.ndindex(4, 3):
            one = getattr(group, name)(*(argument[i] for argument in arguments.get(name, (g,))))
            np.testing.assert_allclose(whole[i], one, atol=1e-15, err_msg=name)


def test_planar_pose_counts_full_turns() -> None:
    """A planar pose keeps its full turns, and log returns the principal value."""
    g = SE2.compose(SE2.exp(np.array([0.0, 0.0, 3.0])), np.array([1.0, 0.0, 3.0 + 4 * np.pi]))
    assert g[2] == pytest.approx(6.0 + 4 * np.pi)
    assert SE2.log(g)[2] == pytest.approx(6.0 - 2 * np.pi)
    assert SO2.log(np.array([2 * np.pi + 1e-3]))[0] == pytest.approx(1e-3, abs=1e-15)
    assert R.log(np.array([50.0]))[0] == 50.0


def test_error_separates_rotation_and_translation() -> None:
    """A shift by (3, 4, 0) and a quarter turn about z, computed manually."""
    g = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    shifted = SE3.error(g, np.array([4.0, 6.0, 3.0, 0.0, 0.0, 0.0, 1.0]))
    assert (float(shifted.rotation), float(shifted.translation)) == (0.0, 5.0)
    half = np.sqrt(0.5)
    rotated = SE3.error(g, np.array([1.0, 2.0, 3.0, 0.0, 0.0, half, half]))
    assert float(rotated.rotation) == pytest.approx(np.pi / 2, abs=1e-15)
    assert float(rotated.translation) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("group", ALL, ids=repr)
def test_pose_accepts_all_input_formats(group: Group) -> None:
    """Coordinates, Pinocchio's coordinates, homogeneous matrices and pin.SE3."""
    g = group.exp(np.linspace(0.2, 0.7, group.dim))
    assert is_same_pose(group, group.pose(g.tolist()), g)
    assert is_same_pose(group, group.pose(group.matrix(g)), g)
    if group.turns == 1:
        assert is_same_pose(group, group.pose([*g[:-1], np.cos(g[-1]), np.sin(g[-1])]), g)
    if group in (SE3, RxSE2):
        assert is_same_pose(group, group.pose(pin.SE3(group.matrix(g))), g)


@pytest.mark.parametrize(
    ("group", "value", "error", "words"),
    [
        (SE3, np.zeros(6), ShapeError, r"shape \(7,\).*got shape \(6,\)"),
        (SE3, [0, 0, 0, 0, 0, 0, 2], InputError, "norm 1, got 2"),
        (SO3, [0, 0, 0, np.nan], ShapeError, "finite"),
        (SO3, 2 * np.eye(3), InputError, "not in SO3"),
        (SE3, np.diag([1.0, 1.0, 1.0, 2.0]), InputError, "not in SE3"),
        (SE2, [0, 0, 0.5, 0.5], InputError, "norm 1"),
        (RxSE2, np.diag([1.0, -1.0, -1.0, 1.0]), InputError, "not in RxSE2"),
        (SO2, "east", ShapeError, "numbers"),
        (R, [[1.0]], ShapeError, "shape"),
    ],
)
def test_pose_rejects_invalid_values(
    group: Group, value: object, error: type[Exception], words: str
) -> None:
    """Wrong shapes, non-finite numbers and values outside the group are rejected."""
    with pytest.raises(error, match=words):
        group.pose(value)


def test_group_named_unknown_lists_valid_names() -> None:
    """The error message lists the valid groups."""
    with pytest.raises(InputError, match="'SE4'; the groups are R, SO2, SE2, SO3, RxSE2, SE3"):
        group_named("SE4")
