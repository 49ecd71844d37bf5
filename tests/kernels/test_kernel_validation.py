"""Every number that a kernel gives is judged: a fault in any of them is found and named."""

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
    """Return the kernel of a tree on a free base, with a spring."""
    system = pinred.load(random_model("SE3", 3, 1))
    springs = {system.shape_names[0]: (1.0, 0.2)}
    scene = pinred.Scene(system=system, seed=0, springs=springs, **options)
    return kernel_of(plan_of(scene), zero_momentum=False)


def pushed_tree() -> Kernel:
    """Return that of a tree with a thruster: its momentum and centre of mass are integrated."""
    thruster = forces.Wrench(lambda _t, x, _xdot, _mu: [0.3, 0.1 * x[0], 0.0, 0.2, 0.0, 0.1])
    return free_tree(forces=thruster)


def heavy_tree() -> Kernel:
    """Return that of a tree on a pivot in gravity, whose attitude nobody asks for."""
    model = random_model("SO3", 3, 1)
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    scene = pinred.Scene(system=pinred.load(model), seed=0, outputs="shape")
    return kernel_of(plan_of(scene), zero_momentum=False)


def driven_tree() -> Kernel:
    """Return that of a tree with a joint that follows a plan."""
    system = pinred.load(random_model("SE3", 3, 1))
    plan = {system.shape_names[1]: pinred.signals.Expression("0.3*sin(2*t)")}
    scene = pinred.Scene(system=system, seed=0, prescribed=plan)
    return kernel_of(plan_of(scene), zero_momentum=False)


def wheels() -> Kernel:
    """Return that of a robot with cyclic joints."""
    scene = pinred.Scene(system=pinred.load("reaction_wheel_satellite"), seed=0)
    return kernel_of(plan_of(scene), zero_momentum=False)


LEAST = 3e-10  # three times what passes


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
def test_a_wrong_output_is_found(name: str, words: str) -> None:
    """Everything that is reported, off by three times what may be."""
    kernel = free_tree()
    validate_kernel(kernel)
    where = getattr(kernel.where, name)
    with pytest.raises(pinred.KernelMismatch, match=f"disagrees with Pinocchio: .*({words}) is"):
        validate_kernel(Faulty(kernel, "out", where.start, where.stop, LEAST))  # type: ignore[arg-type]


def test_the_rate_of_a_light_joint_is_found() -> None:
    """It hardly shows in the momenta, and is judged for itself."""
    kernel = light_tree(1e-3)
    validate_kernel(kernel)
    where = kernel.where.xdot
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: velocity is"):
        validate_kernel(Faulty(kernel, "out", where.start, where.stop, 1e-9))  # type: ignore[arg-type]


def test_the_momentum_of_a_velocity_is_found() -> None:
    """Where a joint is so light that velocities have little to say, momenta have more."""
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
def test_a_fault_in_a_feather_is_found(where: str, name: str, words: str, ratio: float) -> None:
    """However light the last body is: its rate and its force are judged by its own size."""
    kernel = light_tree(ratio)
    validate_kernel(kernel)
    joint = kernel.system.m - 1
    if where == "out":
        first, last = kernel.where.xdot.start + joint, kernel.where.xdot.stop
    else:
        last = places(kernel)[name][1]
        first = last - 1

    class Feather(Faulty):
        def _spoiled(self, place: str, values: Array) -> Array:
            values = values.copy()
            if place == where:
                values[first:last] *= 1.0 + 1e-6
            return values

    with pytest.raises(pinred.KernelMismatch, match=words):
        validate_kernel(Feather(kernel, where, first, last, 0.0))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("c0", "v0", "words"),
    [(1e-9, 0.0, "position of the centre of mass"), (0.0, 1e-9, "velocity of the centre of mass")],
)
def test_a_wrong_path_is_found(c0: float, v0: float, words: str) -> None:
    """Base and centre of mass beside their path, all else as it should be."""
    kernel = free_tree()

    class Beside(Faulty):
        def evaluate_outputs(self, *arguments: Any) -> Array:
            t, y, parameters, line = arguments
            beside = np.concatenate([np.full(3, c0 - v0 * t), np.full(3, v0), np.zeros(3)])
            return kernel.evaluate_outputs(t, y, parameters, line + beside)

    with pytest.raises(pinred.KernelMismatch, match=words):
        validate_kernel(Beside(kernel, "", 0, 0, 0.0))  # type: ignore[arg-type]


def test_a_wrong_energy_is_found() -> None:
    """The last of the outputs."""
    kernel = free_tree()
    size = kernel.where.size
    with pytest.raises(pinred.KernelMismatch, match="energy is off"):
        validate_kernel(Faulty(kernel, "out", size - 1, size, LEAST))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "words"),
    [("driven_x", "prescribed positions"), ("driven_pi", "momenta of prescribed joints")],
)
def test_a_wrong_prescribed_joint_is_found(name: str, words: str) -> None:
    """Where it is, and its momentum."""
    kernel = driven_tree()
    validate_kernel(kernel)
    where = getattr(kernel.where, name)
    with pytest.raises(pinred.KernelMismatch, match=words):
        validate_kernel(Faulty(kernel, "out", where.start, where.stop, LEAST))  # type: ignore[arg-type]


def places(kernel: Kernel) -> dict[str, tuple[int, int]]:
    """Return where each kind of number stands in a rate."""
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
        (wheels, "cyclic", "rate of cyclic joints"),
        (pushed_tree, "push", "rate of the centre of mass"),
        (heavy_tree, "down", "rate of the direction of gravity"),
        (heavy_tree, "momentum", "rate of the angular momentum"),
    ],
)
def test_a_wrong_rate_is_found(make: Any, name: str, words: str) -> None:
    """Each kind of rate, off by three times what may be."""
    kernel = make()
    validate_kernel(kernel)
    first, last = places(kernel)[name]
    with pytest.raises(pinred.KernelMismatch, match=words):
        validate_kernel(Faulty(kernel, "rate", first, last, LEAST))  # type: ignore[arg-type]


@pytest.mark.parametrize("make", [free_tree, pushed_tree, heavy_tree, driven_tree, wheels])
def test_a_wrong_force_is_found(make: Any) -> None:
    """π̇ is judged by the accelerations that follow from it."""
    kernel = make()
    first, last = places(kernel)["pi"]
    with pytest.raises(pinred.KernelMismatch, match="acceleration"):
        validate_kernel(Faulty(kernel, "rate", first, last, 3.0 * LEAST))  # type: ignore[arg-type]


def test_a_slide_that_is_no_wheel_is_found() -> None:
    """Where the base is pushed, the momentum of what slides along is no constant."""
    pushed = pin.Model()
    for i, name in enumerate(("root", "slide")):
        joint = pushed.addJoint(i, pin.JointModelPX(), pin.SE3.Identity(), name)
        pushed.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    pushed.gravity.setZero()
    system = pinred.load(pushed)
    plan = plan_of(pinred.Scene(system=system, seed=0, forces=forces.Wrench([0.8])))
    validate_kernel(kernel_of(plan, zero_momentum=False))
    kind = plan.kind(zero_momentum=False)
    wrong = replace(kind.structure, cyclic=(0,))
    with pytest.raises(pinred.KernelMismatch, match="acceleration"):
        build_kernel(system, wrong, kind.forces)


def single(group: str, moments: list[float], lever: float = 0.0) -> Kernel:
    """Return the kernel of one body of 1 kg with turned principal axes."""
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


@pytest.mark.parametrize("group", ["SO3", "SE3"])
@pytest.mark.parametrize("moments", [*NEARLY, [1e6] * 3])
@pytest.mark.parametrize("lever", [0.0, 0.3])
def test_bodies_with_nearly_equal_moments(group: str, moments: list[float], lever: float) -> None:
    """Their rates are what is left of terms that cancel; faults in what is left are found."""
    kernel = single(group, moments, lever)
    validate_kernel(kernel)
    # A small moment beside a long lever is what is left of a large one.
    fault = 1e-9 if lever == 0.0 or moments[0] > 0.1 else 1e-6
    first, last = places(kernel)["attitude"]
    with pytest.raises(pinred.KernelMismatch, match="attitude rate"):
        validate_kernel(Faulty(kernel, "rate", first, last, fault))  # type: ignore[arg-type]
    where = kernel.where.xi
    with pytest.raises(pinred.KernelMismatch, match="velocity"):
        validate_kernel(Faulty(kernel, "out", where.start, where.stop, fault))  # type: ignore[arg-type]


def spheres(seed: int) -> pin.Model:
    """A tree of spheres on a free base, joined at their centres or beside them."""
    rng = np.random.default_rng(seed)
    model = random_model("SE3", 3, seed, armature=False)
    for i in range(1, model.njoints):
        mass, radius = rng.uniform(0.5, 2.0), rng.choice([1e-3, 0.1, 1.0])
        lever = rng.choice([0.0, 0.2], 3)
        model.inertias[i] = pin.Inertia(float(mass), lever, 0.4 * mass * radius**2 * np.eye(3))
    return model


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_spheres_on_joints(seed: int) -> None:
    """Nothing is refused for its symmetry, and the motion is that of ABA."""
    system = pinred.load(spheres(seed))
    traj = pinred.simulate(system, seed=seed, duration=0.2)
    assert pinred.compare(traj).passed


def small_tree(length: float, mass: float) -> Kernel:
    """Return the kernel of a tree whose lengths and masses are smaller by factors."""
    model = random_model("SE3", 3, 1, armature=False)
    for i in range(1, model.njoints):
        at, body = model.jointPlacements[i], model.inertias[i]
        model.jointPlacements[i] = pin.SE3(at.rotation, length * at.translation)
        moments = mass * length**2 * body.inertia
        model.inertias[i] = pin.Inertia(mass * body.mass, length * body.lever, moments)
    scene = pinred.Scene(system=pinred.load(model), seed=0)
    return kernel_of(plan_of(scene), zero_momentum=False)


@pytest.mark.parametrize("name", ["com", "mu"])
def test_a_small_robot_is_judged_by_its_own_size(name: str) -> None:
    """Momenta of 1e-12 N·m·s are not taken for none."""
    kernel = small_tree(1e-3, 1e-6)
    validate_kernel(kernel)
    where = getattr(kernel.where, name)

    class Wrong(Faulty):
        def _spoiled(self, where: str, values: Array) -> Array:
            values = values.copy()
            if where == "out":
                of_kind = values[self._numbers]
                of_kind[-1] += self._fault * float(np.abs(of_kind).max())
            return values

    with pytest.raises(pinred.KernelMismatch):
        validate_kernel(Wrong(kernel, "out", where.start, where.stop, 1e-9))  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ratio", [1e-6, 1e-12, 1e-14])
def test_a_light_tip_is_neither_refused_nor_passed_over(ratio: float, seed: int) -> None:
    """Its joint is not cyclic though the robot hardly feels it, and its rate is judged."""
    model = random_model("SE3", 3, seed, armature=False)
    tip = model.inertias[model.njoints - 1]
    model.inertias[model.njoints - 1] = pin.Inertia(
        ratio * tip.mass, tip.lever, ratio * tip.inertia
    )
    system = pinred.load(model)
    kernel = kernel_of(plan_of(pinred.Scene(system=system, seed=0)), zero_momentum=False)
    assert kernel.layout.cyclic == ()
    validate_kernel(kernel)
    first, last = places(kernel)["shape"]
    with pytest.raises(pinred.KernelMismatch, match="shape rate"):
        validate_kernel(Faulty(kernel, "rate", first, last, 1e-9))  # type: ignore[arg-type]
    assert pinred.compare(pinred.simulate(system, seed=seed, duration=0.5)).passed


def slide(axis: Array, gravity: float) -> Kernel:
    """Return the kernel of one body on a slide, on which gravity acts along z."""
    model = pin.Model()
    joint = pin.JointModelPrismaticUnaligned(axis / np.linalg.norm(axis))
    at = model.addJoint(0, joint, pin.SE3.Identity(), "root")
    model.appendBodyToJoint(at, pin.Inertia.FromSphere(1.0, 0.15), pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    return kernel_of(plan_of(pinred.Scene(system=pinred.load(model), seed=0)), zero_momentum=False)


@pytest.mark.slow
def test_a_slide_that_is_not_along_gravity(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of gravity, what does not make it fall acts across; along it, round-off of that is left."""
    axes = np.random.default_rng(0).normal(size=(12, 3))
    kernels = [slide(axis, 9.81) for axis in [np.ones(3), *axes]]
    for kernel in kernels:
        validate_kernel(kernel)
    # Scaled by what is left, that would be refused.
    monkeypatch.setattr(ReferenceState, "gravity_terms", np.zeros(1))
    with pytest.raises(pinred.KernelMismatch, match="acceleration"):
        list(map(validate_kernel, kernels))
