"""Loops with closed-form phases: the falling cat, and small loops by the curvature."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from assertions import close
from scipy.spatial.transform import Rotation

import pinred
from pinred.common.arrays import Array

Gait = pinred.Gait


def two_halves(k: float) -> pinred.System:
    """Two equal axisymmetric halves, k = I_axial/I_transverse, joined by massless links."""
    model = pin.Model()
    model.gravity.setZero()
    half = pin.Inertia(1.0, np.zeros(3), np.diag([1.0, 1.0, k]))
    here = pin.SE3.Identity()
    i = model.addJoint(0, pin.JointModelSpherical(), here, "root")
    model.appendBodyToJoint(i, half, here)
    for name, kind in (
        ("a", pin.JointModelRX()),
        ("b", pin.JointModelRY()),
        ("c", pin.JointModelRZ()),
    ):
        i = model.addJoint(i, kind, here, name)
    model.appendBodyToJoint(i, half, here)
    with pytest.warns(pinred.ModelWarning, match="'a' moves no mass at 'b' = "):
        return pinred.load(model)


def bending_gait(beta: float, harmonics: int = 48) -> Gait:
    """The bend by β rotates about the spine without twist: R = exp(β (−sin φ, cos φ, 0))."""
    phi = 2.0 * np.pi * np.arange(4 * harmonics) / (4 * harmonics)
    turns = Rotation.from_rotvec(
        beta * np.stack([-np.sin(phi), np.cos(phi), np.zeros_like(phi)], axis=1)
    )
    x = turns.as_euler("XYZ")  # intrinsic: Rx(a) Ry(b) Rz(c)
    modes = np.fft.rfft(x, axis=0)[: harmonics + 1] / len(phi)
    return Gait.fourier(modes[0].real, 2.0 * modes[1:].real, -2.0 * modes[1:].imag)


@pytest.mark.parametrize(
    ("k", "beta"), [(0.25, np.radians(59.42646)), (0.25, 0.7), (0.6, 1.2), (1.4, 0.5)]
)
@pytest.mark.sampled
def test_falling_cat_matches_closed_form_roll(k: float, beta: float) -> None:
    """The net roll per cycle is 2π (k c/(k c² + s²) − 1), c = cos β/2, s = sin β/2."""
    p = pinred.phase(pinred.Connection.mechanical(two_halves(k)), bending_gait(beta))
    c, s = np.cos(0.5 * beta), np.sin(0.5 * beta)
    roll = 2.0 * np.pi * (k * c / (k * c**2 + s**2) - 1.0)
    assert np.cos(p.screw.angle) == pytest.approx(np.cos(roll), abs=1e-10)
    # The axis bisects the axes of both halves, in the initial frame of the first half.
    axis = np.array([np.sin(0.5 * beta), 0.0, np.cos(0.5 * beta)])
    close(np.cross(p.screw.axis, axis), np.zeros(3), 1e-7)


def test_falling_cat_turns_by_half_a_turn() -> None:
    """For k = 1/4 the bend with k c/(k c² + s²) = 1/2 rotates it by half a turn."""
    # 2 k c = k c² + 1 − c²: a quadratic in c.
    k = 0.25
    c = (-k + np.sqrt(k * k + (1.0 - k))) / (1.0 - k)
    beta = 2.0 * np.arccos(c)
    assert np.degrees(beta) == pytest.approx(59.42646, abs=5e-6)
    p = pinred.phase(
        pinred.Connection.mechanical(two_halves(k)), bending_gait(beta), tolerance=1e-12
    )
    assert p.screw.angle == pytest.approx(np.pi, abs=1e-9)


@pytest.mark.parametrize("name", ["falling_cat", "planar_chain5", "upright_drone"])
def test_small_loop_matches_curvature(name: str) -> None:
    """A circle of radius ε moves the body by exp(−π ε² B), up to an error of order ε³."""
    system = pinred.load(name)
    A, m = pinred.Connection.mechanical(system), system.m
    centre = np.linspace(0.3, 0.7, m)
    B = pinred.Reduction(system).curvature(centre)[:, 0, 1]

    def left(radius: float) -> float:
        direction = radius * np.eye(m)
        p = pinred.phase(A, Gait.fourier(centre, direction[:1], direction[1:2]), tolerance=1e-13)
        return float(np.linalg.norm(p.log + np.pi * radius**2 * B)) / float(np.linalg.norm(B))

    errors = np.array([left(radius) for radius in (0.04, 0.02, 0.01)])
    assert errors[0] < 1e-2 * np.pi * 0.04**2 * 10.0
    orders = np.log2(errors[:-1] / errors[1:])
    assert ((orders > 2.7) & (orders < 4.3)).all()


def test_gait_and_its_reverse_cancel() -> None:
    """A shift conjugates the phase; the time law does not change it."""
    A = pinred.Connection.mechanical(pinred.load("falling_cat"))
    rng = np.random.default_rng(2)
    gait = Gait.fourier(
        rng.normal(size=3) * 0.3, rng.normal(size=(2, 3)) * 0.3, np.ones((2, 3)) * 0.2
    )
    group, p = A.group, pinred.phase(A, gait)

    def apart(g: Array, h: Array) -> float:
        error = group.error(g, h)
        return float(max(error.rotation, error.translation))

    assert apart(group.inverse(p.pose), pinred.phase(A, gait.reversed()).pose) < 1e-10
    assert apart(p.pose, pinred.phase(A, gait.lasting(7.0)).pose) < 1e-10
    # The same loop with start at t₁ has the phase g(t₁)⁻¹ g g(t₁).
    k = len(p.times) // 3
    on_way, share = p.path[k], p.times[k] / gait.period
    shifted = pinred.phase(A, gait.shifted(share)).pose
    expected = group.compose(group.compose(group.inverse(on_way), p.pose), on_way)
    assert apart(expected, shifted) < 1e-10
