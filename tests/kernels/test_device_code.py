"""Code of devices: it has no undefined function, ptxas accepts it, and it integrates as the CPU."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from enum import IntEnum
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from threading import Thread

import llvmlite.binding as llvm
import numpy as np
import pytest
from host_cuda_driver import host_driver

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import DeviceError, UnsupportedOperationError
from pinred.common.machine_code import load_object
from pinred.integrators.integrate import integrate
from pinred.integrators.integrate_many import Solutions, integrate_many
from pinred.integrators.methods import DOP853, Explicit, Tsit5
from pinred.integrators.stepping.call_wrapper import COMPILED
from pinred.integrators.stepping.compiling import compiled
from pinred.integrators.stepping.run_state import (
    DONE,
    EVALUATIONS_BETWEEN_PAUSES,
    LAYOUT,
    TOO_MANY,
    Runs,
)
from pinred.integrators.stepping.step_loop import OUTCOME
from pinred.kernels.build import build_kernel
from pinred.kernels.device import cuda_driver, device_code
from pinred.kernels.device.few_rows import stepper_with_few_rows
from pinred.kernels.differentiable import joined_tangent
from pinred.kernels.kernel import Kernel, Structure
from pinred.kernels.machine.native import compile_object
from pinred.kernels.reduced_graph import ReducedGraph

_EXTERN = b".extern"  # of functions that another module defines


pytestmark = pytest.mark.usefixtures("code_of_default_level")


@pytest.fixture(scope="module")
def kernel(request: pytest.FixtureRequest) -> Kernel:
    """Return a kernel with quaternions and sines, without branches in lanes."""
    request.getfixturevalue("code_of_default_level")
    return build_kernel(pinred.load("falling_cat"), Structure(zero_momentum=False))


@pytest.fixture(scope="module")
def ptx(kernel: Kernel) -> bytes:
    """Return the PTX that integrates with the kernel."""
    return device_code.emit_ptx(device_code.device_ir(kernel, DOP853()))


def _batch(kernel: Kernel, count: int) -> tuple[Array, Array]:
    """Return parameters and initial states of members."""
    rng = np.random.default_rng(5)
    params = np.array([kernel.random_parameters(rng) for _ in range(count)])
    return 0.3 * params, 0.3 * rng.normal(size=(count, kernel.layout.size))


# --- PTX ------------------------------------------------------------------------------------


def test_ptx_has_one_entry_and_no_undefined_function(ptx: bytes) -> None:
    """A device has neither libm nor a linker."""
    assert ptx.count(b".entry") == 1
    assert f".entry {device_code.ENTRY}(".encode() in ptx
    assert _EXTERN not in ptx
    assert b".target sm_90" in ptx


def test_step_loop_rounds_each_operation(ptx: bytes) -> None:
    """Its numbers are those of the CPU; only the kernel and its sines have fused operations."""
    bodies = ptx.partition(f".func  (.param .b32 func_retval0) {COMPILED}(".encode())[2]
    loop, *_ = bodies.partition(b".func rate(")
    assert loop.count(b"mul.rn.f64") > 100
    assert b"fma." not in loop


# Few machines have ptxas; another test looks for undefined functions.
@pytest.mark.by_hand
def test_ptxas_assembles_the_ptx_with_a_known_stack(
    kernel: Kernel, ptx: bytes, tmp_path: Path
) -> None:
    """Recursion or calls by pointers would leave the size of the stack unknown."""
    outputs = device_code.emit_ptx(device_code.outputs_ir(kernel, ("pose", "energy")))
    tangents = device_code.emit_ptx(device_code.device_ir(kernel, DOP853(), tangent=True))
    assert _EXTERN not in tangents
    for code in (ptx, outputs, tangents):
        assert assemble(code, tmp_path, "-O1") > 0


def assemble(code: bytes, folder: Path, level: str) -> int:
    """Assemble PTX with ptxas; return the size of the stack of a thread [bytes]."""
    source, target = folder / "members.ptx", folder / "members.cubin"
    source.write_bytes(code)
    command = [_ptxas(), "-arch=sm_90", level, "-v", str(source), "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    assert target.stat().st_size > 0
    target.unlink()
    (size,) = re.findall(r"(\d+) bytes cumulative stack size", done.stderr)
    return int(size)


def _ptxas() -> str:
    if found := shutil.which("ptxas"):
        return found
    try:
        contents = files("nvidia-cuda-nvcc") or []
    except PackageNotFoundError:
        pytest.skip("no ptxas: install the extra ptxas")
    return next(str(file.locate()) for file in contents if file.name == "ptxas")


def test_ptx_is_cached_by_kernel_and_method(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A second process finds the PTX on disk."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))

    def name_of(_: Kernel, method: Explicit, *, tangent: bool) -> str:
        return method.name + " with tangent" * tangent

    monkeypatch.setattr(device_code, "device_ir", name_of)
    monkeypatch.setattr(device_code, "emit_ptx", str.encode)
    monkeypatch.setattr(device_code, "once", lambda owner, key, make: make())  # noqa: ARG005
    assert device_code.ptx_of(kernel, DOP853()) == b"DOP853"
    monkeypatch.setattr(device_code, "emit_ptx", lambda ir: f"new {ir}".encode())
    assert device_code.ptx_of(kernel, DOP853(rtol=1e-5)) == b"DOP853"
    assert device_code.ptx_of(kernel, Tsit5()) == b"new Tsit5"
    assert device_code.ptx_of(kernel, DOP853(), tangent=True) == b"new DOP853 with tangent"
    other = build_kernel(kernel.system, Structure())
    assert device_code.ptx_of(other, DOP853()) == b"new DOP853"


def test_outputs_are_only_those_of_the_fields(kernel: Kernel) -> None:
    """The base motion is most of the work, and shapes do not need it."""
    few, many = (
        device_code.emit_ptx(device_code.outputs_ir(kernel, names))
        for names in (("x",), ("x", "pose", "energy", "body_momentum"))
    )
    assert f".entry {device_code.OUTPUTS_ENTRY}(".encode() in many
    assert _EXTERN not in many
    assert few.count(b".f64") < 0.1 * many.count(b".f64")


@compiled
def count_times(
    runs: Runs, params: Array, work: Array, times: Array, out: Array, ends: Array, states: Array
) -> int:
    """Return the number of report times: a function with the arguments of a step loop."""
    return len(times) + len(runs) + len(params) + len(work) + len(out) + len(ends) + len(states)


def test_step_loop_without_shipped_bitcode_is_compiled() -> None:
    """The bitcode of a method with coefficients of its own is not in the package."""
    module = llvm.parse_bitcode(device_code.bitcode_of_loop(count_times), llvm.create_context())
    result, error, *arguments = module.get_function(COMPILED).arguments
    assert str(result.type) == str(error.type) == "ptr"
    shipped = llvm.parse_bitcode(
        device_code.bitcode_of_loop(stepper_with_few_rows(DOP853()).loops.advance),
        llvm.create_context(),
    )
    expected = list(shipped.get_function(COMPILED).arguments)[2:]
    assert [str(a.type) for a in arguments] == [str(a.type) for a in expected]


# --- numbers, with threads of the CPU -------------------------------------------------------


def test_members_in_device_threads_equal_single_runs_bit_for_bit(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each thread takes its own parameters, state, end, and times, which may end early."""
    driver = host_driver(monkeypatch)
    params, y0 = _batch(kernel, 66)  # more than one block
    ends = np.linspace(0.002, 0.05, 66)
    times = ends[:, None] * np.array([0.0, 0.3, 0.7, 1.0])
    times[::2, 3] = np.inf
    method = DOP853(rtol=1e-6, max_steps=12)
    many = device_code.integrate_on_device(method, kernel, params, y0, ends, times)
    assert driver.launched == [("context of 0", 66)]
    assert set(many.status) == {DONE, TOO_MANY}
    for k in range(66):
        _check_member(method, kernel, many, k, params[k], y0[k], float(ends[k]))


def test_tangents_in_device_threads_have_the_bits_of_the_cpu(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same loop runs over the same expressions; states have the steps of plain runs."""
    host_driver(monkeypatch)
    graph = ReducedGraph(kernel.system, kernel.structure).rate()
    joined = load_object(compile_object(joined_tangent(graph, "joined"), "joined", []), "joined")
    params, y0 = (np.hstack([a, np.roll(a, 1, axis=1)]) for a in _batch(kernel, 5))
    times, method = [0.0, 0.02, 0.05], DOP853(rtol=1e-6)
    many = device_code.integrate_on_device(method, kernel, params, y0, 0.05, times, tangent=True)
    quaternions = kernel.layout.quaternions
    cpu = integrate_many(
        method, joined.address, params, y0, 0.05, times, quaternions,
        stepper=stepper_with_few_rows(method, tangent=True),
    )  # fmt: skip
    n, p = kernel.layout.size, kernel.layout.parameters
    plain = integrate_many(
        method, kernel.rate.address, params[:, :p], y0[:, :n], 0.05, times, quaternions
    )
    assert np.array_equal(many.y, cpu.y)
    np.testing.assert_allclose(many.y[..., :n], plain.y, rtol=0, atol=1e-10)
    assert many.steps.tolist() == cpu.steps.tolist() == plain.steps.tolist()


def _check_member(
    method: DOP853, kernel: Kernel, many: Solutions, k: int, params: Array, y0: Array, end: float
) -> None:
    """Compare a member with a single run."""
    times = many.times if many.times.ndim == 1 else many.times[k]
    row = times[np.isfinite(times)]
    quaternions = kernel.layout.quaternions
    if many.status[k] == TOO_MANY:
        with pytest.raises(pinred.TooManySteps) as raised:
            integrate(method, kernel.rate.address, params, y0, end, row, quaternions)
        assert many.end[k] == raised.value.time < end
        assert many.steps[k] + many.rejected[k] == method.max_steps
        assert np.isnan(many.y[k, times > raised.value.time]).all()
        return
    one = integrate(method, kernel.rate.address, params, y0, end, row, quaternions)
    assert np.array_equal(many.y[k, : len(row)], one.y)
    counts = (many.steps[k], many.rejected[k], many.evaluations[k])
    assert counts == (one.steps, one.rejected, one.evaluations)
    assert (many.status[k], many.end[k], many.entry[k]) == (DONE, end, -1)


def test_long_member_without_parameters_ends_in_one_launch(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Single runs pause after some evaluations, to look for Ctrl-C; members on devices do not."""
    host_driver(monkeypatch)
    kernel = build_kernel(kernel.system, Structure())
    (params,), (y0,) = _batch(kernel, 1)
    assert len(params) == 0
    many = device_code.integrate_on_device(DOP853(), kernel, [params], [y0], 1.5, [1.5])
    assert many.evaluations[0] > EVALUATIONS_BETWEEN_PAUSES
    _check_member(DOP853(), kernel, many, 0, params, y0, 1.5)


# --- what devices do not have ---------------------------------------------------------------


_POW = """
define double @__nv_pow(double %x, double %y) {
%value = fmul double %x, 2.5e-1
ret double %value
}
define double @__nv_unused(double %x) {
%value = call double @nowhere(double %x)
ret double %value
}
declare double @nowhere(double)
"""


def test_function_that_devices_lack_comes_from_libdevice(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only what is called is linked; the same name serves libm and LLVM's intrinsic."""
    module = llvm.parse_assembly(_POW, llvm.create_context())
    monkeypatch.setattr(device_code, "_libdevice", module.as_bitcode)
    ir = device_code.device_ir(kernel, Tsit5())
    assert "2.500000e-01" in ir
    assert "nowhere" not in ir
    ptx = device_code.emit_ptx(ir)
    assert _EXTERN not in ptx
    both = "declare double @pow(double)\ndeclare double @llvm.pow.f64(double)\ncall @pow(1)"
    renamed = device_code._with_names_of_libdevice(both, ["llvm.pow.f64", "pow"], {"__nv_pow"})
    assert renamed.count("declare double @__nv_pow(") == 1
    assert renamed.endswith("call @__nv_pow(1)")


def test_method_that_needs_pow_is_refused_without_libdevice(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The order of Tsit5 is no power of two, so its steps need a fifth root."""
    monkeypatch.setattr(device_code, "_libdevice", lambda: None)
    with pytest.raises(UnsupportedOperationError, match=r"Tsit5 .* need llvm\.pow\.f64"):
        device_code.device_ir(kernel, Tsit5())


def test_errors_of_the_driver_release_its_memory(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error names the function and the status."""
    driver = host_driver(monkeypatch)
    monkeypatch.setattr(cuda_driver, "MOST", 8)
    allocate = driver.cuMemAlloc

    def second_fails(size: int) -> tuple[IntEnum, int]:
        return allocate(2**40 if driver.memory else size)

    monkeypatch.setattr(driver, "cuMemAlloc", second_fails)
    with pytest.raises(DeviceError, match=r"second_fails failed: CUDA_ERROR_OUT_OF_MEMORY"):
        device_code.integrate_on_device(DOP853(), kernel, *_batch(kernel, 40), 1.0, [1.0])
    assert (driver.memory, driver.streams, driver.contexts) == ({}, {}, [])


# --- launches -------------------------------------------------------------------------------


def _states(kernel: Kernel, progress: Callable[[float], None] | None = None) -> Array:
    """Return states of 66 members, whose ends and report times differ."""
    params, y0 = _batch(kernel, 66)
    ends = np.linspace(0.01, 0.02, 66)
    times = ends[:, None] * np.array([0.3, 1.0])
    method = DOP853(rtol=1e-6)
    many = device_code.integrate_on_device(method, kernel, params, y0, ends, times, progress)
    return many.y


def test_members_are_divided_among_launches_and_devices(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Devices that cannot run the code are left out, and few members take one device."""
    driver = host_driver(monkeypatch)
    expected = _states(kernel)
    assert driver.launched == [("context of 0", 66)]
    monkeypatch.setattr(cuda_driver, "MOST", 7)
    monkeypatch.setattr(cuda_driver, "LEAST", 40)
    driver.capabilities = [(8, 6), (9, 0), (9, 0), (10, 0)]
    driver.launched.clear()
    fractions: list[float] = []
    before = driver.ended

    def progress(fraction: float) -> None:
        fractions.append(fraction)
        assert driver.ended - before == len(fractions)

    assert np.array_equal(_states(kernel, progress), expected)
    places, sizes = zip(*driver.launched, strict=True)
    assert places == ("context of 1", "context of 2") * 5
    assert sizes == (7,) * 9 + (3,)
    assert fractions == [k / 66 for k in (*range(7, 66, 7), 66)]
    assert (driver.memory, driver.streams, driver.contexts) == ({}, {}, [])


def test_launches_fit_into_half_of_the_free_memory(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Others use the device, too."""
    driver = host_driver(monkeypatch)
    expected = _states(kernel)
    driver.limit, driver.launched[:] = 40_000, []
    largest, allocate = [0], driver.cuMemAlloc

    def counted(size: int) -> tuple[IntEnum, int]:
        result = allocate(size)
        largest[0] = max(largest[0], sum(map(len, driver.memory.values())))
        return result

    monkeypatch.setattr(driver, "cuMemAlloc", counted)
    assert np.array_equal(_states(kernel), expected)
    assert len(driver.launched) > 1
    assert 10_000 < largest[0] <= 25_000  # with the alignment of arrays


def test_only_inputs_and_results_are_copied(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The registers of a run stay on the device, and states are not copied there."""
    driver = host_driver(monkeypatch)
    _states(kernel)
    n, parameters = kernel.layout.size, kernel.layout.parameters
    # Parameters, states, ends and times of a member; the registers of all.
    assert driver.copied[0] == 66 * 8 * (parameters + n + 1 + 2) + LAYOUT.itemsize
    assert driver.copied[1] == 66 * (8 * 2 * n + OUTCOME.itemsize)


def test_interrupted_launches_release_their_memory(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C acts between two launches; those that wait are ended first."""
    driver = host_driver(monkeypatch)
    monkeypatch.setattr(cuda_driver, "MOST", 7)

    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _states(kernel, interrupt)
    assert len(driver.launched) == 3
    assert (driver.memory, driver.streams, driver.contexts) == ({}, {}, [])


def test_one_thread_of_a_process_uses_the_devices(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Modules of one thread could be unloaded, and memory be missing, while another runs."""
    driver = host_driver(monkeypatch)
    expected, found = _states(kernel), list[Array]()
    other = Thread(target=lambda: found.append(_states(kernel)))
    with cuda_driver._running:
        other.start()
        other.join(0.5)
        assert len(driver.launched) == 1
    other.join()
    assert np.array_equal(found[0], expected)
    assert len(driver.launched) == 2


def test_module_stays_loaded_for_the_next_run(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The driver assembles a code once; the module that was not used for longest goes."""
    driver = host_driver(monkeypatch)
    monkeypatch.setattr(cuda_driver, "MODULES", 2)
    loaded: list[bytes] = []
    load = driver.cuModuleLoadData

    def counted(image: bytes) -> tuple[IntEnum, tuple[str, int]]:
        loaded.append(image)
        return load(image)

    monkeypatch.setattr(driver, "cuModuleLoadData", counted)
    texts = [f"{device_code.device_ir(kernel, DOP853())}\n; {k}\n".encode() for k in range(3)]
    for k, expected in ((0, 1), (1, 2), (0, 2), (2, 3), (0, 3), (1, 4)):
        monkeypatch.setattr(device_code, "ptx_of", lambda *_, k=k, **_options: texts[k])
        device_code.integrate_on_device(DOP853(), kernel, *_batch(kernel, 1), 0.1, [0.1])
        assert len(loaded) == expected
        assert len(driver.modules) <= 2
