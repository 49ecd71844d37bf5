"""Robots with equal limbs in groups of device threads, whose code the CPU executes in lockstep."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from ball_trees import random_body
from host_cuda_driver import host_driver
from test_device_code import assemble
from trees import limbed_model, mirrored_model

import pinred
from pinred.forces.kinds import Damper, Torque
from pinred.integrators.integrate_many import Solutions, integrate_many
from pinred.integrators.methods import DOP853
from pinred.integrators.stepping.run_state import DONE, NOT_FINITE, TOO_MANY
from pinred.kernels.build import build_kernel
from pinred.kernels.device import device_code, equal_limbs
from pinred.kernels.device.cuda_driver import Launch, run_on_devices
from pinred.kernels.device.equal_limbs import Group, exchange_ir, group_of
from pinred.kernels.kernel import Kernel, Structure
from pinred.reduction.tree.identical_branches import Lanes
from pinred.system.system import System


def spider(seed: int = 0, limbs: int = 4, *, balls: bool = False, arms: int = 0) -> System:
    """Return a body with equal limbs of three hinges and a tail of one.

    With balls, a limb hangs on a ball. Arms have two sliders.
    """
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"spider-{limbs}-{seed}"
    model.gravity.setZero()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, *random_body(rng))
    tail = model.addJoint(root, pin.JointModelRY(), pin.SE3.Random(), "tail")
    model.appendBodyToJoint(tail, *random_body(rng))
    for limb in range(limbs):
        parent = root
        for k, kind in enumerate((pin.JointModelRZ, pin.JointModelRX, pin.JointModelRX)):
            if balls and k == 0:
                kind = pin.JointModelSpherical
            place = pin.SE3(pin.exp3(0.3 * rng.normal(size=3)), 0.3 * rng.normal(size=3))
            if balls:  # limbs with other frames of balls do not share lanes
                place.rotation = np.eye(3)
            parent = model.addJoint(parent, kind(), place, f"limb{limb}_{k}")
            model.appendBodyToJoint(parent, *random_body(rng))
    for arm in range(arms):
        parent = root
        for k in range(2):
            place = pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3))
            parent = model.addJoint(parent, pin.JointModelPX(), place, f"arm{arm}_{k}")
            model.appendBodyToJoint(parent, *random_body(rng))
    return System(model)


def _kernel(system: System) -> Kernel:
    return build_kernel(system, Structure(zero_momentum=False))


def _group(system: System) -> Group | None:
    return group_of(_kernel(system))


# --- which robots, and how they are divided ------------------------------------------------------


def test_threads_have_the_entries_of_their_limb_and_copies_of_the_others() -> None:
    """Each entry of the state belongs to one thread or to all."""
    system = spider()
    kernel, group = _kernel(system), _group(system)
    assert group is not None
    own = np.array([row[: group.own] for row in group.places])
    shared = {row[group.own :] for row in group.places}
    assert len(shared) == 1
    assert own.shape == (4, 6)
    assert sorted([*own.ravel().tolist(), *shared.pop()]) == list(range(kernel.layout.size))
    # Joint angles come first, sorted as the joints of the model, then the momenta.
    m = system.m
    joints = [system.space.names[k % m] for k in own.ravel() % m]
    assert [name.split("_")[0] for name in joints] == [f"limb{k // 6}" for k in range(24)]


@pytest.mark.parametrize(
    "system",
    [
        pinred.load("falling_cat"),
        pinred.load("satellite_two_arms"),
        spider(limbs=3),
        spider(limbs=1),
        spider(balls=True),
        spider(arms=2),
    ],
    ids=["no limbs", "two limbs save too little", "three limbs", "one limb", "balls", "two arms"],
)
def test_other_robots_have_one_thread_for_a_member(system: System) -> None:
    """Groups are chosen by what a thread saves, and their size is that of SIMD lanes."""
    assert _group(system) is None


def _limbs_of(*packs: list[ca.SX], y: ca.SX, p: ca.SX) -> dict[int, tuple[int, ...]] | None:
    """Return the entries that belong to limbs in a graph which sums products of packs."""
    lanes = Lanes()
    product = ca.SX(1.0)
    for numbers in packs:
        product *= lanes.pack(numbers)
    function = lanes.function("rate", [y, p], ca.SX(lanes.sum(product, len(packs[0]))) * y)
    return equal_limbs._Expressions(function, lanes.marks["rate"]).entries_of_limbs()


def test_entries_belong_to_one_limb_each() -> None:
    """A graph in which an entry belongs to several limbs has no group."""
    y, p = ca.SX.sym("y", 4), ca.SX.sym("p", 2)
    assert _limbs_of([y[2], y[3]], y=y, p=p) == dict.fromkeys((2, 3), (2, 3))
    assert _limbs_of([y[2], y[3]], [y[3], y[2]], y=y, p=p) is None
    assert _limbs_of([y[0], y[1], y[0], y[1]], y=y, p=p) is None


def test_parameters_belong_to_no_limb() -> None:
    """Indices of parameters are no entries of the state, although both begin at zero."""
    y, p = ca.SX.sym("y", 4), ca.SX.sym("p", 2)
    assert _limbs_of([p[0], p[1]], [y[2], y[3]], y=y, p=p) == dict.fromkeys((2, 3), (2, 3))


@pytest.mark.by_hand
def test_stack_of_a_thread_is_little_more_than_half(tmp_path: Path) -> None:
    """What groups are for: rows and spilled numbers stay near the processor."""
    kernel = _kernel(spider())
    with_group = device_code.device_ir(kernel, DOP853())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(device_code, "group_of", lambda _, **_options: None)
        alone = device_code.device_ir(kernel, DOP853())
    sizes = [assemble(device_code.emit_ptx(ir), tmp_path, "-O3") for ir in (with_group, alone)]
    assert sizes[0] < 0.55 * sizes[1]


def test_cached_code_tells_groups_from_single_threads(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Files and memory have both for one kernel."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(device_code, "device_ir", lambda *_, **__: "code")
    monkeypatch.setattr(device_code, "emit_ptx", lambda _: b"group")
    kernel, method = _kernel(spider()), DOP853()
    assert device_code.ptx_of(kernel, method) == b"group"
    monkeypatch.setattr(device_code, "group_of", lambda _, **_options: None)
    monkeypatch.setattr(device_code, "emit_ptx", lambda _: b"alone")
    assert device_code.ptx_of(kernel, method) == b"alone"
    assert device_code.ptx_of(_kernel(kernel.system), method) == b"alone"
    monkeypatch.undo()
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))
    assert device_code.ptx_of(_kernel(kernel.system), method) == b"group"


# --- exchanges -----------------------------------------------------------------------------------


@pytest.mark.parametrize("threads", equal_limbs.WIDTHS)
def test_all_threads_of_a_group_get_the_same_bits(
    threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sums are added in pairs, so that no thread rounds differently."""
    host_driver(monkeypatch)
    groups = 24  # more than a block of 64 threads
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=(groups, threads)) * 10.0 ** rng.integers(-8, 8, (groups, threads))
    indices = rng.integers(-1, 3, (groups, threads))
    indices[3] = -1
    code = f"""
{exchange_ir(threads)}
define ptx_kernel void @exchange(i64 %N, ptr %numbers, ptr %indices, ptr %sums, ptr %ofs,
                                 ptr %firsts) {{
%tid = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
%block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
%before = mul i32 %block, 64
%thread32 = add i32 %before, %tid
%thread = zext i32 %thread32 to i64
%last = mul i64 %N, {threads}
%is = icmp slt i64 %thread, %last
br i1 %is, label %begin, label %end
begin:
%number.at = getelementptr double, ptr %numbers, i64 %thread
%number = load double, ptr %number.at
%index.at = getelementptr i64, ptr %indices, i64 %thread
%index = load i64, ptr %index.at
%sum = call double @pinred.sum(double %number)
%of = call double @pinred.of(double %number, i32 1)
%first = call i64 @pinred.first(i64 %index)
%sum.at = getelementptr double, ptr %sums, i64 %thread
store double %sum, ptr %sum.at
%of.at = getelementptr double, ptr %ofs, i64 %thread
store double %of, ptr %of.at
%first.at = getelementptr i64, ptr %firsts, i64 %thread
store i64 %first, ptr %first.at
br label %end
end:
ret void
}}
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
"""
    sums, ofs = np.empty((groups, threads)), np.empty((groups, threads))
    firsts = np.empty((groups, threads), np.int64)
    launch = Launch(code.encode(), "exchange", (), (numbers, indices), (sums, ofs, firsts), threads)
    run_on_devices(launch)
    pairs = numbers
    while pairs.shape[1] > 1:
        pairs = pairs[:, ::2] + pairs[:, 1::2]
    assert np.array_equal(sums, np.repeat(pairs, threads, axis=1))
    assert np.array_equal(ofs, np.repeat(numbers[:, 1:2], threads, axis=1))
    first = np.where(indices < 0, 99, indices).min(axis=1)
    first[first == 99] = -1
    assert first[3] == -1
    assert np.array_equal(firsts, np.repeat(first[:, None], threads, axis=1))


# --- motions -------------------------------------------------------------------------------------


def _agree(system: System, monkeypatch: pytest.MonkeyPatch, **options: Any) -> None:
    """Compare members in groups of threads with members on the CPU."""
    cpu = pinred.simulate_many(system, **options)
    driver = host_driver(monkeypatch)
    device = pinred.simulate_many(system, device="cuda", explain=True, **options)
    assert driver.memory == {}
    assert device.failures == cpu.failures
    assert np.array_equal(np.isnan(device.y), np.isnan(cpu.y))
    scale = np.nanmax(np.abs(cpu.y))
    assert np.nanmax(np.abs(device.y - cpu.y)) <= 1e-11 * scale
    (found,), (expected,) = device._batches, cpu._batches
    assert (expected.steps > 3).all()
    # Copies count once in the errors: otherwise steps would be shorter.
    assert (np.abs(found.steps - expected.steps) <= 1).all()


def _options(system: System, count: int = 6, seed: int = 5) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    return {
        "members": {
            "x0": 0.3 * rng.normal(size=(count, system.m)),
            "xdot0": rng.normal(size=(count, system.m)),
            "xi0": 0.5 * rng.normal(size=(count, 6)),
        },
        "times": [0.0, 0.1, 0.33, 0.6],
        "method": "DOP853(rtol=1e-11, atol=1e-11)",
    }


@pytest.mark.by_hand
def test_members_in_groups_of_threads_agree_with_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """There are more members than a block has groups."""
    system = spider()
    assert _group(system) is not None
    _agree(system, monkeypatch, **_options(system, 18))


def test_members_with_forces_on_single_limbs_agree_with_the_cpu(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A torque on one limb depends on another one, so a thread tells its number to the others."""
    monkeypatch.setattr(equal_limbs, "SHARE", 1.0)
    system = spider(1)
    gains = [pinred.Parameter("gain", 0.1), pinred.Parameter("other", 0.2)]

    def torque(t: ca.SX, x: Any, xdot: Any, _: Any) -> Any:
        return ca.sin(x["limb3_1"]) * xdot["tail"] + ca.fmax(x["limb1_0"], 0.1) * ca.cos(3 * t)

    options = _options(system)
    options["members"]["gain"] = np.linspace(0.1, 0.3, 6)
    forces: list[Any] = [Damper(name, gains["limb2" in name]) for name in system.space.names]
    forces.append(Torque({"limb0_2": torque}))
    _agree(system, monkeypatch, forces=forces, **options)
    assert "6 members one per 4 threads of a device (cuda), DOP853" in capsys.readouterr().out


@pytest.mark.parametrize("angles", [(1, 2, 3, 0), (0, 0, 1, 1)], ids=["ring", "pairs"])
def test_torques_of_other_limbs_agree_with_the_cpu(
    angles: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Equal expressions of all limbs have entries of the state of other threads."""
    monkeypatch.setattr(equal_limbs, "SHARE", 1.0)
    system = spider()

    def torque(limb: int) -> Any:
        joint = f"limb{limb}_0"
        return lambda _, x, xdot, *__: ca.sin(x[joint]) - 0.1 * xdot[joint]

    torques = {f"limb{k}_0": torque(limb) for k, limb in enumerate(angles)}
    _agree(system, monkeypatch, forces=[Torque(torques)], **_options(system, 2))


@pytest.mark.by_hand
@pytest.mark.parametrize("method", ["DOP853", "Tsit5"])
def test_two_threads_integrate_two_limbs(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where groups of two would not be chosen, and with another method and one error."""
    # The steps of Tsit5 need a root, which libm computes here.
    known = re.compile(f"{device_code._INTRINSICS.pattern}|llvm\\.pow\\.")
    monkeypatch.setattr(device_code, "_INTRINSICS", known)
    monkeypatch.setattr(equal_limbs, "SHARE", 1.0)
    system = pinred.load("satellite_two_arms")
    options = _options(system, 4)
    _agree(system, monkeypatch, **options | {"method": f"{method}(rtol=1e-9, atol=1e-9)"})


@pytest.mark.by_hand
@pytest.mark.parametrize("make", [limbed_model, mirrored_model])
@pytest.mark.parametrize("seed", [0, 1])
def test_random_limbs_agree_with_the_cpu(
    make: Any, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Constants of limbs agree, differ, vanish or differ by sign; joints are of all types."""
    monkeypatch.setattr(equal_limbs, "SHARE", 1.0)
    system = System(make("SE3", 4, 2, seed))
    assert _group(system) is not None
    _agree(system, monkeypatch, **_options(system, 3))


# --- members that end early ----------------------------------------------------------------------


def _not_finite(joint: str, *, infinite: bool, at: float = 3.0) -> Any:
    """Return a torque that is not finite where a joint, or else the time, is beyond `at`."""

    def torque(t: ca.SX, x: Any, *_: Any) -> Any:
        beyond = (x[joint] if joint else t) > at
        if infinite:
            return 1.0 / ca.if_else(beyond, 0.0, 10.0)
        return ca.sqrt(ca.if_else(beyond, -1.0, 0.01))

    return torque


def _torques(*joints: str, first: bool, infinite: bool = False) -> list[Any]:
    """Return torques on joints that are not finite at first, for the first member, or later."""
    torque = _not_finite("tail" if first else "", infinite=infinite, at=3.0 if first else 0.06)
    return [Torque(dict.fromkeys(joints, torque))]


@pytest.mark.parametrize(
    ("joints", "named", "first", "infinite"),
    [
        # Entry 2 of one thread comes before entry 1 of another, and that of the trunk before both.
        (("limb0_2", "limb1_0"), "limb0_2", True, False),
        pytest.param(("limb0_0", "tail"), "tail", True, True, marks=pytest.mark.by_hand),
        pytest.param(("limb3_1",), "limb3_1", False, False, marks=pytest.mark.by_hand),
        pytest.param(("limb2_1",), "limb2_1", False, True, marks=pytest.mark.by_hand),
        pytest.param(("limb3_0", "limb1_2"), "limb1_2", False, False, marks=pytest.mark.by_hand),
    ],
)
def test_entry_that_is_not_finite_ends_a_member_as_on_the_cpu(
    joints: tuple[str, ...],
    named: str,
    first: bool,
    infinite: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One thread has such an entry, or several have; all of the group end, others go on."""
    monkeypatch.setattr(equal_limbs, "SHARE", 1.0)
    system = spider(1)
    options = _options(system, 3) | {"times": [0.0, 0.05, 0.1]}
    options |= {"method": "DOP853(rtol=1e-6, max_steps=60)"}
    options["members"]["x0"][0, system.space.names.index("tail")] = 3.1
    options["forces"] = _torques(*joints, first=first, infinite=infinite)
    cpu = pinred.simulate_many(system, **options)
    host_driver(monkeypatch)
    group = pinred.simulate_many(system, device="cuda", **options)
    monkeypatch.setattr(device_code, "group_of", lambda _, **_options: None)
    monkeypatch.setattr(device_code, "ptx_of", lambda *a, **_: device_code.device_ir(*a).encode())
    alone = pinred.simulate_many(system, device="cuda", **options)
    reason = f"the momentum of joint '{named}' is not finite"
    assert {failure.reason for failure in cpu.failures} == {reason}
    assert [failure.member for failure in cpu.failures] == ([0] if first else [0, 1, 2])
    for device in (group, alone):
        assert [(f.member, f.reason) for f in device.failures] == [
            (f.member, f.reason) for f in cpu.failures
        ]
        own, those = ([failure.time for failure in many.failures] for many in (device, cpu))
        np.testing.assert_allclose(own, those, rtol=1e-14)
        np.testing.assert_allclose(device.y, cpu.y, rtol=0, atol=1e-12)  # NaN at the same times
        (found,), (expected,) = device._batches, cpu._batches
        assert found.steps.tolist() == expected.steps.tolist()
        assert found.evaluations.tolist() == expected.evaluations.tolist()


def _solutions(kernel: Kernel, count: int, method: DOP853, *, device: bool) -> Solutions:
    """Integrate members whose ends, report times and numbers of steps differ."""
    rng = np.random.default_rng(3)
    y0 = 0.3 * rng.normal(size=(count, kernel.layout.size))
    first, quaternions = kernel.layout.quaternions
    assert quaternions == 1
    y0[:, first : first + 4] /= np.linalg.norm(y0[:, first : first + 4], axis=1)[:, None]
    y0[2::7, 17] = 1e200  # products of this momentum overflow, and the member fails at once
    ends = rng.uniform(0.002, 2.0, count)
    times = ends[:, None] * np.array([0.0, 0.3, 0.7, 1.0])
    times[::2, 3] = np.inf
    params = rng.normal(size=(count, kernel.layout.parameters))
    if device:
        return device_code.integrate_on_device(method, kernel, params, y0, ends, times)
    return integrate_many(
        method, kernel.rate.address, params, y0, ends, times, kernel.layout.quaternions
    )


@pytest.mark.parametrize("count", [1, 19])
def test_neighbours_in_a_warp_end_at_other_times(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A warp has 8 groups and a block 16, so the last ones have threads without members."""
    kernel, method = _kernel(spider()), DOP853(rtol=1e-7, atol=1e-7, max_steps=6)
    expected = _solutions(kernel, count, method, device=False)
    driver = host_driver(monkeypatch)
    found = _solutions(kernel, count, method, device=True)
    assert [launched for _, launched in driver.launched] == [count]
    if count > 1:
        assert {*expected.status.tolist()} == {DONE, NOT_FINITE, TOO_MANY}
        assert len({*expected.steps.tolist()}) > 3
        assert expected.rejected.any()
    for name in ("status", "entry", "steps", "rejected", "evaluations"):
        assert getattr(found, name).tolist() == getattr(expected, name).tolist(), name
    # The lengths of steps contain the round-off of small errors.
    np.testing.assert_allclose(found.end, expected.end, rtol=1e-7)
    np.testing.assert_allclose(found.y, expected.y, rtol=0, atol=1e-9)
