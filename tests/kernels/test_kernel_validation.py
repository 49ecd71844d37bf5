"""Tests that the validation of kernels detects a fault in any value and names it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from faulty_kernels import Faulty, light_tree
from trees import random_model

import pinred
from pinred import forces
from pinred.common.arrays import Array
from pinred.kernels.build import build_kernel
from pinred.kernels.kernel import Kernel
from pinred.kernels.reference_state import ReferenceState
from pinred.kernels.validation import validate_kernel
from pinred.simulation.compiled.compiled_flow import kernel_of
from pinred.simulation.plan import plan_of


def free_tree(**options: Any) -> Kernel:
    """Return the kernel of a tree on a free base with a spring."""
    system = pinred.load(random_model("SE3", 3, 1))
    springs = {system.shape_names[0]: (1.0, 0.2)}
    scene = pinred.Scene(system=system, seed=0, springs=springs, **options)
    return kernel_of(plan_of(scene), zero_momentum=False)


def pushed_tree() -> Kernel:
    """Return the kernel of a tree with a thruster, which integrates momentum and centre of mass."""
    thruster = forces.Wrench(lambda _t, x, _xdot, _mu: [0.3, 0.1 * x[0], 0.0, 0.2, 0.0, 0.1])
    return free_tree(forces=thruster)


def heavy_tree() -> Kernel:
    """Return the kernel of a tree on a pivot under gravity, without the base in its outputs."""
    model = random_model("SO3", 3, 1)
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    scene = pinred.Scene(system=pinred.load(model), seed=0, outputs="shape")
    return kernel_of(plan_of(scene), zero_momentum=False)


def prescribed_tree() -> Kernel:
    """Return the kernel of a tree with a prescribed joint."""
    system = pinred.load(random_model("SE3", 3, 1))
    plan = {system.shape_names[1]: pinred.signals.Expression("0.3*sin(2*t)")}
    scene = pinred.Scene(system=system, seed=0, prescribed=plan)
    return kernel_of(plan_of(scene), zero_momentum=False)


def wheeled_robot() -> Kernel:
    """Return the kernel of a robot with cyclic joints."""
    scene = pinred.Scene(system=pinred.load("reaction_wheel_satellite"), seed=0)
    return kernel_of(plan_of(scene), zero_momentum=False)


def slice_of(kernel: Kernel, name: str) -> slice:
    """Return the slice of an output, or of a field of the state among the outputs."""
    where: slice = getattr(kernel.where, name, None) or kernel.where.fields[name]
    return where


LEAST = 3e-10  # three times the tolerance


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("xi", "velocity"),
        ("xdot", "velocity"),
        ("com", "centre of mass"),
        ("mu", "momentum"),
        ("x", "shape"),
        ("pose", "configuration"),
        ("q", "configuration"),
        ("v", "velocity|momentum"),
        ("body_momentum", "body momentum"),
        ("spatial_momentum", "spatial momentum"),
    ],
)
def test_validation_detects_wrong_output(name: str, words: str) -> None:
    """Each output with an error of three times the tolerance is rejected."""
    kernel = free_tree()
    validate_kernel(kernel)
    where = slice_of(kernel, name)
    with pytest.raises(pinred.KernelMismatch, match=f"disagrees with Pinocchio: .*({words}) is"):
        validate_kernel(Faulty(kernel, "out", where.start, where.stop, LEAST))  # type: ignore[arg-type]


def test_validation_detects_wrong_rate_of_light_joint() -> None:
    """The rate of a hinge hardly affects the momenta, so it is compared separately."""
    kernel = light_tree(1e-3, seed=5)
    validate_kernel(kernel)
    where = kernel.where.xdot
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: velocity is"):
        validate_kernel(Faulty(kernel, "out", where.start, where.stop, 1e-9))  # type: ignore[arg-type]


def test_validation_detects_wrong_momentum_of_velocity() -> None:
    """If a joint is very light, momenta are more precise than velocities."""
    kernel = light_tree(1e-6)
    validate_kernel(kernel)
    where = kernel.where.xi
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: momentum of the velocity is"):
        validate_kernel(Faulty(kernel, "out", where.start, where.stop, 1e-9))  # type: ignore[arg-type]


@pytest.mark.parametrize("ratio", [1e-9, 1e-12, 1e-15])
@pytest.mark.parametrize(
    ("where", "name", "words"),
    [
        ("out", "xdot", "(momentum of the )?velocity is"),
        ("rate", "pi", "acceleration is"),
    ],
)
def test_validation_detects_fault_in_very_light_body(
    where: str, name: str, words: str, ratio: float
) -> None:
    """Rate and force of a light last body are compared relative to their own size."""
    kernel = light_tree(ratio)
    validate_kernel(kernel)
    joint = kernel.system.m - 1
    if where == "out":
        first, last = kernel.where.xdot.start + joint, kernel.where.xdot.stop
    else:
        last = rate_slices(kernel)[name][1]
        first = last - 1

    class FaultyLight(Faulty):
        def _spoiled(self, place: str, values: Array) -> Array:
            values = values.copy()
            if place == where:
                values[first:last] *= 1.0 + 1e-6
            return values

    with pytest.raises(pinred.KernelMismatch, match=words):
        validate_kernel(FaultyLight(kernel, where, first, last, 0.0))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("c0", "v0", "words"),
    [(1e-9, 0.0, "position of the centre of mass"), (0.0, 1e-9, "velocity of the centre of mass")],
)
def test_validation_detects_wrong_com_path(c0: float, v0: float, words: str) -> None:
    """A displaced centre of mass is rejected if all other values are correct."""
    kernel = free_tree()

    class Displaced(Faulty):
        def evaluate_outputs(self, *arguments: Any) -> Array:
            t, y, parameters, com_path = arguments
            error = np.concatenate([np.full(3, c0 - v0 * t), np.full(3, v0), np.zeros(3)])
            return kernel.evaluate_outputs(t, y, parameters, com_path + error)

    with pytest.raises(pinred.KernelMismatch, match=words):
        validate_kernel(Displaced(kernel, "", 0, 0, 0.0))  # type: ignore[arg-type]


def test_validation_detects_wrong_energy() -> None:
    """The energy is the last output."""
    kernel = free_tree()
    size = kernel.where.size
    with pytest.raises(pinred.KernelMismatch, match="energy is off"):
        validate_kernel(Faulty(kernel, "out", size - 1, size, LEAST))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "words"),
    [("driven_x", "prescribed positions"), ("driven_pi", "momenta of prescribed joints")],
)
def test_validation_detects_wrong_prescribed_joint(name: str, words: str) -> None:
    """Position and momentum of a prescribed joint are compared."""
    kernel = prescribed_tree()
    validate_kernel(kernel)
    where = slice_of(kernel, name)
    with pytest.raises(pinred.KernelMismatch, match=words):
        validate_kernel(Faulty(kernel, "out", where.start, where.stop, LEAST))  # type: ignore[arg-type]


def rate_slices(kernel: Kernel) -> dict[str, tuple[int, int]]:
    """Return first and last index of each kind of entry in a rate."""
    layout, parts = kernel.layout, kernel.layout.base
    a, b = len(layout.active), layout.base_at
    sizes = (parts.attitude, parts.down, parts.momentum, parts.push)
    ends = b + np.cumsum([0, *sizes])
    base = zip(ends.tolist(), ends[1:].tolist(), strict=False)
    names = ("shape", "pi", "cyclic", "attitude", "down", "momentum", "push")
    return dict(zip(names, [(0, a), (a, 2 * a), (2 * a, b), *base], strict=True))


@pytest.mark.parametrize(
    ("make", "name", "words"),
    [
        (free_tree, "shape", "shape rate"),
        (free_tree, "attitude", "attitude rate"),
        (wheeled_robot, "cyclic", "rate of cyclic joints"),
        (pushed_tree, "push", "rate of the centre of mass"),
        (heavy_tree, "down", "rate of the direction of gravity"),
        (heavy_tree, "momentum", "rate of the angular momentum"),
    ],
)
def test_validation_detects_wrong_rate(make: Any, name: str, words: str) -> None:
    """Each kind of rate with an error of three times the tolerance is rejected."""
    kernel = make()
    validate_kernel(kernel)
    first, last = rate_slices(kernel)[name]
    with pytest.raises(pinred.KernelMismatch, match=words):
        validate_kernel(Faulty(kernel, "rate", first, last, LEAST))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "make", [free_tree, pushed_tree, heavy_tree, prescribed_tree, wheeled_robot]
)
def test_validation_detects_wrong_momentum_rate(make: Any) -> None:
    """π̇ is compared by the accelerations that follow from it."""
    kernel = make()
    first, last = rate_slices(kernel)["pi"]
    with pytest.raises(pinred.KernelMismatch, match="acceleration"):
        validate_kernel(Faulty(kernel, "rate", first, last, 3.0 * LEAST))  # type: ignore[arg-type]


def test_validation_detects_joint_wrongly_declared_cyclic() -> None:
    """A wrench on the base changes the momentum of a slide along it."""
    pushed = pin.Model()
    for i, name in enumerate(("root", "slide")):
        joint = pushed.addJoint(i, pin.JointModelPX(), pin.SE3.Identity(), name)
        pushed.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    pushed.gravity.setZero()
    system = pinred.load(pushed)
    plan = plan_of(pinred.Scene(system=system, seed=0, forces=forces.Wrench([0.8])))
    validate_kernel(kernel_of(plan, zero_momentum=False))
    wrong = replace(plan.structure(zero_momentum=False), cyclic=(0,))
    with pytest.raises(pinred.KernelMismatch, match="acceleration"):
        build_kernel(system, wrong, plan.forces)


def single_body(group: str, moments: list[float], lever: float = 0.0) -> Kernel:
    """Return the kernel of one body of 1 kg with rotated principal axes."""
    model = pin.Model()
    kind = pin.JointModelSpherical() if group == "SO3" else pin.JointModelFreeFlyer()
    at = model.addJoint(0, kind, pin.SE3.Identity(), "root")
    turn = pin.exp3(np.array([0.3, 0.2, 0.1]))
    body = pin.Inertia(1.0, np.array([lever, 0.0, lever]), turn @ np.diag(moments) @ turn.T)
    model.appendBodyToJoint(at, body, pin.SE3.Identity())
    model.gravity.setZero()
    scene = pinred.Scene(system=pinred.load(model), seed=0)
    return kernel_of(plan_of(scene), zero_momentum=False)


NEARLY = [[1.0] * 3, [0.4, 0.4, 0.4 + 1e-9], [1.0, 1.0, 1.0001], [1e-6] * 3, [1e-6, 1.1e-6, 1.2e-6]]


@pytest.mark.sampled(5)
@pytest.mark.parametrize("group", ["SO3", "SE3"])
@pytest.mark.parametrize("lever", [0.0, 0.3])
@pytest.mark.parametrize("moments", [*NEARLY, [1e6] * 3])
def test_validation_of_bodies_with_nearly_equal_moments(
    group: str, moments: list[float], lever: float
) -> None:
    """Rates are small differences of cancelling terms, and faults in them are detected."""
    kernel = single_body(group, moments, lever)
    validate_kernel(kernel)
    # With a long lever, a small moment of inertia is a difference of large ones.
    fault = 1e-9 if lever == 0.0 or moments[0] > 0.1 else 1e-6
    first, last = rate_slices(kernel)["attitude"]
    with pytest.raises(pinred.KernelMismatch, match="attitude rate"):
        validate_kernel(Faulty(kernel, "rate", first, last, fault))  # type: ignore[arg-type]
    where = kernel.where.xi
    with pytest.raises(pinred.KernelMismatch, match="velocity"):
        validate_kernel(Faulty(kernel, "out", where.start, where.stop, fault))  # type: ignore[arg-type]


def sphere_tree(seed: int) -> pin.Model:
    """Return a tree of spheres on a free base, jointed at their centres or off-centre."""
    rng = np.random.default_rng(seed)
    model = random_model("SE3", 3, seed, armature=False)
    for i in range(1, model.njoints):
        mass, radius = rng.uniform(0.5, 2.0), rng.choice([1e-3, 0.1, 1.0])
        lever = rng.choice([0.0, 0.2], 3)
        model.inertias[i] = pin.Inertia(float(mass), lever, 0.4 * mass * radius**2 * np.eye(3))
    return model


@pytest.mark.by_hand("1", "3")
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.sampled
def test_sphere_trees_pass_validation_and_agree_with_aba(seed: int) -> None:
    """Symmetric bodies pass validation, and their motion agrees with ABA."""
    system = pinred.load(sphere_tree(seed))
    traj = pinred.simulate(system, seed=seed, duration=0.2)
    assert pinred.compare(traj).passed


def small_tree(length: float, mass: float) -> Kernel:
    """Return the kernel of a tree with scaled lengths and masses."""
    model = random_model("SE3", 3, 1, armature=False)
    for i in range(1, model.njoints):
        at, body = model.jointPlacements[i], model.inertias[i]
        model.jointPlacements[i] = pin.SE3(at.rotation, length * at.translation)
        moments = mass * length**2 * body.inertia
        model.inertias[i] = pin.Inertia(mass * body.mass, length * body.lever, moments)
    scene = pinred.Scene(system=pinred.load(model), seed=0)
    return kernel_of(plan_of(scene), zero_momentum=False)


@pytest.mark.parametrize("name", ["com", "mu"])
def test_validation_scales_with_small_robot(name: str) -> None:
    """Momenta of 1e-12 N·m·s are not treated as zero."""
    kernel = small_tree(1e-3, 1e-6)
    validate_kernel(kernel)
    where = slice_of(kernel, name)

    class Wrong(Faulty):
        def _spoiled(self, where: str, values: Array) -> Array:
            values = values.copy()
            if where == "out":
                of_kind = values[self._numbers]
                of_kind[-1] += self._fault * float(np.abs(of_kind).max())
            return values

    with pytest.raises(pinred.KernelMismatch):
        validate_kernel(Wrong(kernel, "out", where.start, where.stop, 1e-9))  # type: ignore[arg-type]


@pytest.mark.by_hand("1e-12-0")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ratio", [1e-6, 1e-12, 1e-14])
@pytest.mark.sampled
def test_light_tip_is_accepted_and_its_faults_detected(ratio: float, seed: int) -> None:
    """The joint of a light tip is not cyclic, and its rate is compared."""
    model = random_model("SE3", 3, seed, armature=False)
    tip = model.inertias[model.njoints - 1]
    model.inertias[model.njoints - 1] = pin.Inertia(
        ratio * tip.mass, tip.lever, ratio * tip.inertia
    )
    system = pinred.load(model)
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    assert kernel.layout.cyclic == ()
    validate_kernel(kernel)
    first, last = rate_slices(kernel)["shape"]
    with pytest.raises(pinred.KernelMismatch, match="shape rate"):
        validate_kernel(Faulty(kernel, "rate", first, last, 1e-9))  # type: ignore[arg-type]
    assert pinred.compare(pinred.simulate(system, seed=seed, duration=0.5)).passed


def slide_under_gravity(axis: Array, gravity: float) -> Kernel:
    """Return the kernel of one body on a slide, with gravity along z."""
    model = pin.Model()
    joint = pin.JointModelPrismaticUnaligned(axis / np.linalg.norm(axis))
    at = model.addJoint(0, joint, pin.SE3.Identity(), "root")
    model.appendBodyToJoint(at, pin.Inertia.FromSphere(1.0, 0.15), pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    return kernel_of(plan_of(pinred.Scene(system=pinred.load(model), seed=0)), zero_momentum=False)


@pytest.mark.slow
def test_validation_allows_round_off_of_gravity_across_slide(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Gravity across the slide leaves round-off along it, which must be tolerated."""
    axes = np.random.default_rng(0).normal(size=(12, 3))
    kernels = [slide_under_gravity(axis, 9.81) for axis in [np.ones(3), *axes]]
    for kernel in kernels:
        validate_kernel(kernel)
    # Without the magnitude of gravity, this round-off would be rejected.
    monkeypatch.setattr(ReferenceState, "gravity_terms", np.zeros(1))
    with pytest.raises(pinred.KernelMismatch, match="acceleration"):
        list(map(validate_kernel, kernels))
