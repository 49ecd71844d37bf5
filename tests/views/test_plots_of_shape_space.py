"""Portraits, curvature, momentum sphere and sections, against closed forms and Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from figures import beanie, drawn, units
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from scipy.spatial.transform import Rotation

import pinred
from pinred import plots
from pinred.common.arrays import Array
from pinred.views.plots.phase_space import crossings


def contours(axes: Axes) -> list[Any]:
    """Return the contour sets of some axes."""
    return [item for item in axes.collections if isinstance(item, QuadContourSet)]


def vertices(contour: Any) -> Array:
    """Return all points of all lines of a contour set, (P, 2)."""
    return np.concatenate([path.vertices for path in contour.get_paths() if len(path.vertices)])


def assert_passes(path: tuple[Array, Array], points: list[Array]) -> None:
    """Assert that a path assert_passes through points in order, with small turns."""
    where = [
        int(np.argmin(np.hypot(path[0] - a, path[1] - b))) for a, b in zip(*points, strict=True)
    ]
    np.testing.assert_array_equal([path[0][where], path[1][where]], points)
    assert where[0] == 0
    assert where[-1] == len(path[0]) - 1
    assert (np.diff(where) > 0).all()
    ways = np.diff(np.stack(path), axis=1)
    angles = np.unwrap(np.arctan2(ways[1], ways[0]))
    assert np.abs(np.diff(angles))[np.hypot(*ways)[1:] > 1e-3].max() < 0.5


def cartpole() -> pinred.Trajectory:
    """Simulate the cart with a swinging pole from its default state."""
    return pinred.simulate(pinred.load("cartpole"), duration=3.0)


def test_portrait_of_one_joint_in_closed_form() -> None:
    """V = −4.905 cos x, M = 0.34 − cos²x/12; the path is on a level of ½ M ẋ² + V."""
    traj = cartpole()
    figure = plots.phase(traj)
    top, portrait = figure.axes
    x, potential = drawn(top, "amended potential")
    np.testing.assert_allclose(potential, -4.905 * np.cos(x), atol=1e-12)

    def energy(x: Array, rate: Array) -> Array:
        return np.asarray(0.5 * (0.34 - np.cos(x) ** 2 / 12) * rate**2 - 4.905 * np.cos(x))

    path = energy(*drawn(portrait, "path"))
    np.testing.assert_allclose(path, path[0], rtol=1e-8)
    np.testing.assert_allclose(drawn(top, "energy")[1], path[0], rtol=1e-9)
    (levels,) = contours(portrait)
    for level, curve in zip(np.ravel(levels.levels), levels.get_paths(), strict=True):
        if len(curve.vertices):
            np.testing.assert_allclose(energy(*curve.vertices.T), level, atol=5e-3)
    assert [axes.get_xlabel() for axes in figure.axes] == ["", "pole_pivot [rad]"]
    assert units(figure) == ["potential [J]", "rate [rad/s]"]


def test_portrait_includes_springs_and_momentum() -> None:
    """For the beanie with J = 1.5 and k = 1: V = ½ x² + ½ 1.5²/3."""
    traj, _ = beanie()
    top, _ = plots.phase(traj, limits=[(-1.0, 1.0)]).axes
    x, potential = drawn(top, "amended potential")
    np.testing.assert_allclose(potential, 0.5 * x**2 + 0.375, atol=1e-12)
    assert (x[0], x[-1]) == (-1.0, 1.0)


def test_portrait_energy_equals_pinocchio() -> None:
    """In the plane, it is Pinocchio's kinetic energy without that of the centre of mass."""
    system = pinred.load("planar_chain5", lock=["joint2", "joint3", "joint4", "joint5"])
    traj = pinred.simulate(system, x0=[0.7], xdot0=[0.9], xi0=[1.0, -2.0, 0.8], duration=5.0)
    model, data = system.model, system.model.createData()
    figure = plots.phase(traj, when=2.0)
    top, portrait = figure.axes
    state = traj(2.0)
    pin.ccrba(model, data, state.q, state.v)
    carried = 0.5 * data.hg.linear @ data.hg.linear / system.mass
    expected = pin.computeKineticEnergy(model, data, state.q, state.v) - carried
    assert drawn(top, "energy")[1] == pytest.approx(expected, rel=1e-9)
    # Where the joint turns, all of this energy is potential.
    x, potential = drawn(top, "amended potential")
    still, rate = drawn(portrait, "path")
    for k in np.flatnonzero(rate[:-1] * rate[1:] < 0.0):
        assert np.interp(still[k], x, potential) == pytest.approx(expected, rel=1e-2)
    assert carried > 0.1 * expected
    assert ", potential for" not in figure.get_suptitle()


def test_portrait_of_two_joints_equals_pinocchio() -> None:
    """½ L·I⁻¹L with Pinocchio's centroidal inertia at every drawn shape."""
    system = pinred.load("falling_cat")
    traj = pinred.simulate(system, duration=2.0)
    figure = plots.phase(traj, joints=["bend", "twist"], limits=[(-1, 1), (-0.5, 0.5)], when=1.0)
    main, bar, first, second = sorted(
        figure.axes, key=lambda a: units(figure).index(a.get_ylabel())
    )
    model, data = system.model, system.model.createData()
    state = traj(1.0)
    pin.ccrba(model, data, state.q, state.v)
    L = Rotation.from_quat(state.q[3:7]).inv().apply(data.hg.angular)
    field = next(item for item in contours(main if contours(main) else bar) if item.filled)
    low, high = np.inf, -np.inf
    for a in np.linspace(-1, 1, 61):
        for b in np.linspace(-0.5, 0.5, 61):
            q = system.q(system.group.identity(), [a, state.x[1], b])
            pin.ccrba(model, data, q, np.zeros(system.n))
            value = 0.5 * L @ np.linalg.solve(data.Ig.inertia, L)
            low, high = min(low, value), max(high, value)
    assert field.zmin == pytest.approx(low, rel=1e-9)
    assert field.zmax == pytest.approx(high, rel=1e-9)
    assert "sway" in figure.get_suptitle()
    assert "μ of t = 1 s" in figure.get_suptitle()
    assert units(figure).count("rate [rad/s]") == 2
    assert_passes(drawn(first, "path"), [traj.x[:, 0], traj.xdot[:, 0]])
    assert_passes(drawn(second, "path"), [traj.x[:, 2], traj.xdot[:, 2]])


def test_path_stays_below_energy_level() -> None:
    """On the path the potential never exceeds the drawn energy level."""
    system = pinred.load("planar_chain5", lock=["joint3", "joint4", "joint5"])
    springs = {"joint1": (2.0, 0.0), "joint2": (1.0, 0.2)}
    traj = pinred.simulate(
        system, x0=[0.6, -0.5], momentum=[0, 0, 1.0], springs=springs, duration=20.0
    )
    figure = plots.phase(traj)
    (main,) = [axes for axes in figure.axes if contours(axes) and "joint2" in axes.get_ylabel()]
    level = [item for item in contours(main) if len(item.levels) == 1]
    assert len(level) == 1
    red = pinred.Reduction(system, springs=springs)
    potential = [red.amended_potential(x, [0, 0, 1.0]) for x in traj.x]
    # By momentum about the centre of mass, as the total linear momentum is zero.
    assert max(potential) <= level[0].levels[0] * (1 + 1e-9)
    for a, b in vertices(level[0])[::7]:
        assert red.amended_potential([a, b], [0, 0, 1.0]) == pytest.approx(
            level[0].levels[0], rel=1e-3
        )


def test_portrait_without_potential_states_reason() -> None:
    """For example, a pivot in gravity."""
    top = pinred.load("coupled_spatial", group="SO3", gravity=(0, 0, -9.81))
    figure = plots.phase(pinred.simulate(top, seed=0, duration=0.5))
    assert "gravity rotates the base" in figure.get_suptitle()
    assert not any(contours(axes) for axes in figure.axes)
    cat = pinred.load("falling_cat")
    still = pinred.simulate(cat, x0=[0.1, 0.2, 0.3], xdot0=[1, 0, 0], momentum=0, duration=0.5)
    assert "is 0 J everywhere" in plots.phase(still).get_suptitle()


def curvature_by_differences(system: pinred.System, x: Array, a: int, b: int) -> Array:
    """Compute B_ab by central differences of A = I⁻¹ H_bs from Pinocchio's mass matrix."""
    data, r = system.model.createData(), system.r

    def connection(x: Array) -> Array:
        H = pin.crba(system.model, data, system.q(system.group.identity(), x))
        H = np.triu(H) + np.triu(H, 1).T
        return np.asarray(np.linalg.solve(H[:r, :r], H[:r, r:]))

    step, e = 1e-4, np.eye(system.m)
    slope = [
        (connection(x + step * e[k]) - connection(x - step * e[k])) / (2 * step) for k in (a, b)
    ]
    A = connection(x)
    return np.asarray(slope[0][:, b] - slope[1][:, a] - system.group.bracket(A[:, a], A[:, b]))


def test_curvature_plot_equals_differences() -> None:
    """Extremes and zero contour are those of differences of A."""
    system = pinred.load("planar_chain5")
    at = np.array([0.0, 0.0, 0.3, -0.2, 0.1])
    figure = plots.curvature(system, joints=["joint1", "joint2"], component="w",
                             limits=[(-1.5, 1.5), (-1.0, 1.0)], at=at)  # fmt: skip
    axes = figure.axes[0]
    field, _, zero = contours(axes)
    assert field.filled
    corners = []
    for a in np.linspace(-1.5, 1.5, 7):
        for b in np.linspace(-1.0, 1.0, 5):
            x = at.copy()
            x[:2] = a, b
            corners.append(curvature_by_differences(system, x, 0, 1)[2])
    assert field.zmin <= min(corners) + 1e-6
    assert field.zmax >= max(corners) - 1e-6
    assert field.zmax - field.zmin < 1.2 * np.ptp(corners)
    assert list(zero.levels) == [0.0]
    for a, b in vertices(zero)[::5]:
        x = at.copy()
        x[:2] = a, b
        assert abs(curvature_by_differences(system, x, 0, 1)[2]) < 1e-3 * np.ptp(corners)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("joint1 [rad]", "joint2 [rad]")
    assert figure.axes[1].get_ylabel() == "B, component ω [rad/rad²]"


def test_curvature_plot_of_motion_has_path() -> None:
    """The largest rotation is selected by default."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=1.0)
    axes = pinred.plot(traj, "curvature", joints=("sway", "twist")).axes[0]
    assert_passes(drawn(axes, "path"), [traj.x[:, 1], traj.x[:, 2]])
    figure = pinred.plot(traj, "curvature", component="v2")
    assert figure.axes[1].get_ylabel() == "B, component v2 [m/rad²]"
    with pytest.raises(pinred.InputError, match="the components are v1, v2, v3, ω1, ω2, ω3"):
        pinred.plot(traj, "curvature", component="w4")
    with pytest.raises(pinred.InputError, match="expected two joints"):
        pinred.plot(traj, "curvature", joints=["bend"])
    with pytest.raises(pinred.InputError, match="limits must increase"):
        pinred.plot(traj, "curvature", limits=[(0, 1), (1, 1)])
    with pytest.raises(pinred.InputError, match="a finite \\(low, high\\)"):
        pinred.plot(traj, "curvature", limits=(0, 1))  # type: ignore[call-overload]
    with pytest.raises(pinred.InputError, match="needs a robot with at least 2 joints"):
        pinred.plot(cartpole(), "curvature")
    with pytest.raises(pinred.InputError, match=r"path must be shapes over time, \(T, 3\)"):
        pinred.plot(traj, "curvature", path=[0.0, 1.0, 2.0])


def test_zero_curvature_is_stated() -> None:
    """On rails, A = ∂c/∂x is a gradient, so its curvature is zero."""
    rails = pinred.load("falling_cat", group="R")
    figure = plots.curvature(rails)
    assert "component v, is zero everywhere" in figure.get_suptitle().replace("\n", " ")
    assert figure.axes[1].get_ylabel() == "B, component v [m/rad²]"
    assert "zero" not in plots.curvature(pinred.load("falling_cat")).get_suptitle()


def test_rigid_body_moves_on_sphere() -> None:
    """|L| is constant, and L = (1, 2, 2.5) times the rates, which obey Euler's equations."""
    traj = pinred.simulate(pinred.load("rigid_body"), duration=6.0)
    figure = plots.sphere(traj)
    axes: Any = figure.axes[0]
    (near,) = [line for line in axes.lines if line.get_label() == "path"]
    points = np.array(near.get_data_3d()).T
    visible = ~np.isnan(points).any(axis=1)
    moments = np.array([1.0, 2.0, 2.5])
    assert visible.sum() > 100
    for rates in traj.xi[::20]:
        distance = np.linalg.norm(points[visible] - rates * moments, axis=1)
        assert distance.min() < 1e-12
    start = moments * [0.5, 0.7, 1.6]
    size = np.linalg.norm(start)
    np.testing.assert_allclose(np.linalg.norm(points[visible], axis=1), size, rtol=1e-9)
    energy = 0.5 * points[visible] ** 2 @ (1 / moments)
    np.testing.assert_allclose(energy, 0.5 * start**2 @ (1 / moments), rtol=1e-8)
    assert f"|L| = {size:.4g}" in figure.get_suptitle()
    assert axes.get_zlabel() == "L3 [N·m·s]"


@pytest.mark.parametrize("moments", [(1.0, 2.0, 2.5), (1.0, 1.0, 1.5), (1.0, 1.5, 1.5), (2, 2, 2)])
def test_level_curves_keep_momentum_and_energy(moments: tuple[float, float, float]) -> None:
    """They cover both sides of the separatrix, if there is one."""
    from pinred.views.plots.phase_space import level_curves

    turn = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    inverse = turn @ np.diag(1 / np.array(moments)) @ turn.T
    curves = level_curves(np.linalg.inv(inverse), 3.0)
    energies = []
    for curve in curves:
        np.testing.assert_allclose(np.linalg.norm(curve, axis=1), 3.0, rtol=1e-12)
        energy = 0.5 * np.einsum("pi,ij,pj->p", curve, inverse, curve)
        np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
        energies.append(energy[0])
    if moments == (2, 2, 2):
        assert not curves
        return
    assert len(np.unique(np.round(energies, 9))) >= 4
    if len(set(moments)) == 3:
        middle = 0.5 * 9.0 / sorted(moments)[1]
        assert min(energies) < middle < max(energies)
        assert np.isclose(energies, middle).sum() == 2


def test_body_momentum_equals_pinocchio() -> None:
    """About the centre of mass, rotated to the body frame, for a robot of many bodies."""
    from pinred.views.plots.phase_space import angular_momentum

    traj = pinred.simulate(pinred.load("satellite_two_arms"), duration=2.0)
    model, data = traj.system.model, traj.system.model.createData()
    momentum = angular_momentum(traj, traj.states)
    for k in range(0, len(traj), 40):
        pin.ccrba(model, data, traj.q[k], traj.v[k])
        expected = Rotation.from_quat(traj.q[k, 3:7]).inv().apply(data.hg.angular)
        np.testing.assert_allclose(momentum[k], expected, atol=1e-11)


def test_sphere_plot_rejects_zero_momentum_and_other_groups() -> None:
    """The messages state the reason."""
    cat = pinred.load("falling_cat")
    still = pinred.simulate(cat, x0=[0.1, 0.2, 0.3], xdot0=[1, 0, 0], momentum=0, duration=0.5)
    with pytest.raises(pinred.InputError, match="zero angular momentum"):
        pinred.plot(still, "sphere")
    with pytest.raises(pinred.InputError, match="for SO3 and SE3, not for R"):
        pinred.plot(cartpole(), "sphere")


def test_crossings_in_closed_form() -> None:
    """For the beanie, 0.4 cos(ωt) is zero at (k + ½)π/ω."""
    traj, _ = beanie()
    omega = np.sqrt(1.5)

    def height(t: Array) -> Array:
        return traj.at(t).x[:, 0]

    expected = (np.arange(2) + 0.5) * np.pi / omega
    np.testing.assert_allclose(crossings(traj, height), expected, atol=1e-9)
    assert not crossings(traj, lambda t: height(t) - 1.0).size


def two_pendulums() -> list[pinred.Trajectory]:
    """Simulate two motions of the double spherical pendulum."""
    system = pinred.load("double_spherical_pendulum")
    return [
        pinred.simulate(system, x0=[a, 0.1, 0.0], xdot0=[0, 0.5, 0.2], xi0=[1.0], duration=20.0)
        for a in (0.3, 0.5)
    ]


def test_section_equals_full_simulation() -> None:
    """Pinocchio's ABA with SciPy's event detection crosses at the same points."""
    from scipy.integrate import solve_ivp

    (traj, _) = two_pendulums()
    system = traj.system
    model, data = system.model, system.model.createData()
    n = system.n

    def rate(_: float, y: Array) -> Array:
        q = system.q(y[:1], y[1:n])
        return np.concatenate([y[n:], pin.aba(model, data, q, y[n:], np.zeros(n))])

    def height(_: float, y: Array) -> float:
        return float(y[1])

    height.direction = 1.0  # type: ignore[attr-defined]
    start = np.concatenate([traj.pose[0], traj.x[0], traj.xi[0], traj.xdot[0]])
    full = solve_ivp(rate, (0, 20), start, "DOP853", events=height, rtol=1e-11, atol=1e-12)
    expected = full.y_events[0][:, [2, n + 2]]
    figure = plots.poincare(traj, value=0.0)
    x, xdot = drawn(figure.axes[0], f"motion 1: {len(expected)} crossings")
    np.testing.assert_allclose(np.stack([x, xdot], axis=1), expected, atol=1e-6)
    assert len(expected) > 5
    names = system.shape_names
    assert figure.axes[0].get_xlabel() == f"{names[1]} [rad]"
    assert units(figure) == [f"rate of {names[1]} [rad/s]"]


def test_section_of_several_motions_and_full_rotations() -> None:
    """Each motion has a marker; a rotating joint crosses once per rotation."""
    motions = two_pendulums()
    assert len(plots.poincare(motions, value=0.0, direction=0).axes[0].lines) == 2
    up, down, both = (
        np.column_stack(plots.poincare(motions[0], direction=way).axes[0].lines[0].get_data())
        for way in (1, -1, 0)
    )
    assert len(up) + len(down) == len(both)
    assert sorted([*up.tolist(), *down.tolist()]) == sorted(both.tolist())
    assert abs(len(up) - len(down)) <= 1
    system = pinred.load("reaction_wheel_satellite")
    traj = pinred.simulate(system, duration=5.0)
    wheel = traj.x[:, 1]
    figure = plots.poincare(traj, joints=(1, 0), value=1.0)
    turns = np.floor((wheel[-1] - 1.0) / (2 * np.pi)) - np.floor((wheel[0] - 1.0) / (2 * np.pi))
    assert turns > 10
    assert len(figure.axes[0].lines[0].get_xdata()) == turns  # type: ignore[arg-type]


def test_section_default_value_is_middle_of_range() -> None:
    """Without a value, the section is in the middle of the joint's range."""
    traj = two_pendulums()[0]
    t = np.linspace(0.0, 20.0, 20001)
    x = traj.at(t).x[:, 0]
    figure = plots.poincare(traj)
    middle = 0.5 * (x.min() + x.max())
    title = figure.get_suptitle()
    assert float(title.split("= ")[1].split(" rad")[0]) == pytest.approx(middle, abs=1e-4)
    upwards = ((x[:-1] < middle) & (x[1:] >= middle)).sum()
    assert f"motion 1: {upwards} crossings" in str(figure.axes[0].lines[0].get_label())


def test_section_rejects_invalid_input() -> None:
    """Too few joints, no crossing, several robots, the same joint twice."""
    traj = two_pendulums()[0]
    with pytest.raises(pinred.InputError, match="at least 2 joints"):
        pinred.plot(cartpole(), "poincare")
    with pytest.raises(pinred.InputError, match="does not cross 3 rad"):
        pinred.plot(traj, "poincare", value=3.0)
    with pytest.raises(pinred.InputError, match="direction must be"):
        pinred.plot(traj, "poincare", direction=3)
    with pytest.raises(pinred.InputError, match="distinct joints"):
        pinred.plot(traj, "poincare", joints=(1, 1))
    with pytest.raises(pinred.InputError, match="one robot only"):
        plots.poincare([traj, cartpole()])
    with pytest.raises(pinred.InputError, match="value must be finite"):
        pinred.plot(traj, "poincare", value=np.nan)
