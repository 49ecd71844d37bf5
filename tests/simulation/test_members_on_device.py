"""simulate_many on a CUDA device, whose threads the CPU executes, and what it refuses."""

from __future__ import annotations

import inspect
import re
import sys
from typing import Any

import casadi as ca
import numpy as np
import pytest
from host_cuda_driver import host_driver

import pinred
from pinred.common.errors import (
    DeviceError,
    InputError,
    MissingPackageError,
    UnsupportedOperationError,
)
from pinred.forces.kinds import Torque
from pinred.forces.signals.signal import Hold
from pinred.integrators.methods import DOP853, Explicit, Tsit5
from pinred.kernels.device import cuda_driver, device_code
from pinred.system.system import System


@pytest.fixture(scope="module")
def cat() -> System:
    """Return the falling cat."""
    return pinred.load("falling_cat")


def _wave(t: ca.SX, *_: object) -> ca.SX:
    return 1e-2 * ca.sin(30.0 * t)


def _options(system: System) -> dict[str, Any]:
    """Return a batch with forces of time, two spans of time, and an angle beyond 2²⁰ rad."""
    first, second, *_ = system.space.names
    x0 = 0.3 * np.random.default_rng(2).normal(size=(10, system.m))
    x0[3, 0] += 2.0**22
    return {
        "members": {"x0": x0},
        "xdot0": np.full(system.m, 0.5),
        "xi0": [0.1, 0.0, 0.0, 0.3, -0.2, 0.4],
        "times": np.linspace(0.0, 0.4, 5),
        "method": DOP853(rtol=1e-10, atol=1e-10),
        "forces": [Torque({first: Hold([0.0, 0.2], [1e-2, -1e-2]), second: _wave})],
    }


def test_members_in_device_threads_agree_with_members_in_lanes(
    cat: System, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only round-off differs; each span of time is a launch."""
    driver = host_driver(monkeypatch)
    cpu = pinred.simulate_many(cat, **_options(cat))
    fractions: list[float] = []
    device = pinred.simulate_many(
        cat, device="cuda", explain=True, progress=fractions.append, **_options(cat)
    )
    assert "10 members one per thread of a device (cuda), DOP853" in capsys.readouterr().out
    assert len(driver.launched) == len(fractions) > 1
    assert fractions[-1] == 1.0
    assert driver.memory == {}
    assert not device.failures
    # The large angle is a multiple of its spacing, and the attitude follows it.
    bound = np.full(10, 1e-13)
    bound[3] = 4.0 * np.spacing(2.0**22)
    for values, expected in ((device.x, cpu.x), (device.pose, cpu.pose)):
        assert (np.abs(values - expected).max(axis=(1, 2)) <= bound).all()


# Whether time is an input of the outputs is tested in test_member_outputs.py.
@pytest.mark.by_hand("time is an input")
@pytest.mark.parametrize("forces", [False, True], ids=["time is an input", "time is a state"])
def test_states_are_computed_on_the_device(
    cat: System, monkeypatch: pytest.MonkeyPatch, *, forces: bool
) -> None:
    """Two members have no momentum, so each launch computes the states of some members only."""
    driver = host_driver(monkeypatch)
    options = _options(cat) | ({} if forces else {"forces": []})
    xi0 = np.repeat([options["xi0"]], 10, axis=0)
    xi0[[1, 7]] = 0.0
    rates = np.full((10, cat.m), 0.5)
    rates[[1, 7]] = 0.0
    options["members"] |= {"xi0": xi0, "xdot0": rates}
    options["members"]["x0"][3] = 0.1
    del options["xi0"], options["xdot0"]
    cpu = pinred.simulate_many(cat, **options)
    device = pinred.simulate_many(cat, device="cuda", **options)
    before, driver.launched[:] = tuple(driver.copied), []
    energy = device.fields(["energy"])["energy"]
    assert sum(size for _, size in driver.launched) == 10
    assert driver.copied[1] - before[1] == energy.nbytes  # nothing else is copied
    np.testing.assert_allclose(energy, cpu.energy, rtol=0, atol=1e-12)
    driver.launched.clear()
    alone = {member: device[member] for member in (1, 4)}
    assert [size for _, size in driver.launched] == [1, 1]
    for name in ("x", "xdot", "xi", "pose", "q", "v", "body_momentum", "spatial_momentum"):
        values, expected = getattr(device, name), getattr(cpu, name)
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-12, err_msg=name)
        for member, traj in alone.items():
            assert np.array_equal(getattr(traj, name), values[member]), name


# `test_outputs_are_only_those_of_the_fields` computes fewer fields, too.
@pytest.mark.by_hand
def test_states_of_shapes_alone_are_computed_on_the_device(
    cat: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the base there are fewer fields."""
    driver = host_driver(monkeypatch)
    options = _options(cat) | {"outputs": "shape", "momentum": 0.0}
    options["members"]["x0"][3] = 0.1
    del options["xi0"]
    device = pinred.simulate_many(cat, device="cuda", **options)
    cpu = pinred.simulate_many(cat, **options)
    launches = len(driver.launched)
    np.testing.assert_allclose(device.xdot, cpu.xdot, rtol=0, atol=1e-12)
    assert len(driver.launched) == launches + 1
    assert np.array_equal(device[2].energy, device.energy[2])


def test_states_with_functions_that_devices_lack_are_computed_on_the_cpu(
    cat: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A potential may need functions that its forces do not."""
    driver = host_driver(monkeypatch)
    options = _options(cat)
    device = pinred.simulate_many(cat, device="cuda", **options)
    launches = len(driver.launched)

    def refuse(*_: object) -> bytes:
        raise UnsupportedOperationError("device: no log")

    monkeypatch.setattr(device_code, "outputs_ptx", refuse)
    assert np.isfinite(device.energy).all()
    assert len(driver.launched) == launches


def test_body_without_reduced_states_moves_on_a_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its kernel computes nothing, so the rate of the one number in its place must be zero."""
    host_driver(monkeypatch)
    cart = pinred.load("cartpole", lock=["pole_pivot"])
    options: dict[str, Any] = {"xi0": np.array([[1.0], [2.0]]), "times": [2.0], "method": "DOP853"}
    device = pinred.simulate_many(cart, device="cuda", **options)
    assert device.y.tolist() == [[[0.0]], [[0.0]]]
    np.testing.assert_array_equal(device.pose, pinred.simulate_many(cart, **options).pose)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"device": "gpu"}, "device: expected None or 'cuda', got 'gpu'"),
        ({"threads": 2}, "threads: expected None with a device, got 2. Omit it"),
        ({"method": "Gauss(0.1)"}, "method: expected DOP853 or Tsit5 on a device, got Gauss"),
    ],
)
def test_options_that_do_not_fit_a_device_are_refused(
    cat: System, options: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The CPU would integrate all of them."""
    host_driver(monkeypatch)
    options = {"device": "cuda", **options}
    with pytest.raises(InputError, match=re.escape(message)):
        pinred.simulate_many(cat, seeds=range(2), times=[0.1], **options)


def test_members_that_are_simulated_one_by_one_are_refused(cat: System) -> None:
    """The reason and the remedy are in the message."""
    event = pinred.Event(f"x['{cat.space.names[0]}'] - 0.1", "bent")
    with pytest.raises(InputError, match=r"2 that are simulated one by one: .* Omit device"):
        pinred.simulate_many(cat, seeds=range(2), times=[0.1], events=[event], device="cuda")


def test_forces_with_functions_that_devices_lack_are_refused(
    cat: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message names the function, and the extra that has it."""
    host_driver(monkeypatch)
    monkeypatch.setattr(device_code, "_libdevice", lambda: None)
    force = Torque({cat.space.names[0]: lambda t, *_: 1e-3 * ca.exp(-t)})
    with pytest.raises(
        UnsupportedOperationError, match=r"'falling_cat' need exp, .* pip install \"pinred\[ptxas\]"
    ):
        pinred.simulate_many(cat, seeds=range(2), times=[0.1], forces=[force], device="cuda")


def _functions(t: ca.SX, *_: object) -> ca.SX:
    """Return a sum of functions of libm."""
    powers = (1 + t) ** 1.3 + ca.exp(-t) + ca.expm1(t) + ca.log(1 + t) + ca.log1p(t)
    angles = ca.tan(t) + ca.asin(0.3 * t) + ca.acos(0.1 * t) + ca.atan(t) + ca.atan2(t, 2)
    hyperbolic = ca.sinh(t) + ca.cosh(t) + ca.tanh(3 * t) + ca.asinh(t) + ca.acosh(1.5 + t)
    return 1e-2 * (powers + angles + hyperbolic + ca.atanh(0.2 * t) + ca.erf(t) + ca.hypot(t, 2))


@pytest.mark.parametrize("method", [DOP853(), Tsit5()], ids=lambda method: method.name)
def test_functions_of_libdevice_agree_with_libm(
    cat: System, method: Explicit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The CPU executes libdevice; its steps need roots with Tsit5."""
    host_driver(monkeypatch)
    if device_code._libdevice() is None:
        pytest.skip("no libdevice: install the extra ptxas")
    options = _options(cat) | {"method": method}
    options["members"]["x0"][3] = 0.1  # libdevice reduces large angles with other instructions
    options["forces"] = [Torque({cat.space.names[0]: _functions})]
    cpu = pinred.simulate_many(cat, **options)
    device = pinred.simulate_many(cat, device="cuda", **options)
    np.testing.assert_allclose(device.x, cpu.x, rtol=0, atol=1e-13)
    np.testing.assert_allclose(device.pose, cpu.pose, rtol=0, atol=1e-13)


# --- machines without a device ---------------------------------------------------------------


def test_missing_package_names_the_extra_before_code_is_generated(
    cat: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The package is optional."""
    host_driver(monkeypatch)
    monkeypatch.setitem(sys.modules, "cuda.bindings.driver", None)
    monkeypatch.setattr(device_code, "ptx_of", None)
    with pytest.raises(MissingPackageError, match=r'cuda-bindings: pip install "pinred\[gpu\]"'):
        pinred.simulate_many(cat, seeds=range(2), times=[0.1], method="DOP853", device="cuda")


def test_missing_device_is_an_error_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    """The driver may be installed without a device."""
    host_driver(monkeypatch).capabilities = []
    message = r"found none \(.*cuInit failed: CUDA_ERROR_NO_DEVICE\)\. Omit device"
    with pytest.raises(DeviceError, match=message):
        cuda_driver._open_devices()


def test_device_of_a_lower_capability_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Older devices reject the PTX."""
    host_driver(monkeypatch).capabilities = [(8, 6), (7, 5)]
    with pytest.raises(DeviceError, match=r"capability 9\.0 or higher, got 8\.6, 7\.5"):
        cuda_driver._open_devices()


def test_stand_in_has_functions_of_the_driver_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """A function of another name would exist on no machine."""
    real = pytest.importorskip("cuda.bindings.driver", reason="no cuda-bindings: extra gpu")
    stand_in = host_driver(monkeypatch)
    names = [name for name in dir(type(stand_in)) if name.startswith("cu")]
    assert len(names) > 10
    for name in names:
        ours = list(inspect.signature(getattr(stand_in, name)).parameters)
        if "sizes" not in ours:
            theirs = getattr(real, name).__doc__.partition("(")[2].partition(")")[0]
            assert len(ours) == len([part for part in theirs.split(",") if part]), name
    assert real.CUdevice_attribute.CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR == 75
    assert real.CUdevice_attribute.CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR == 76


def test_machine_without_the_driver_is_an_error() -> None:
    """The package alone finds no driver."""
    real = pytest.importorskip("cuda.bindings.driver", reason="no cuda-bindings: extra gpu")
    try:
        has_device = int(real.cuInit(0)[0]) == 0
    except RuntimeError:
        has_device = False
    if has_device:
        pytest.skip("this machine has a device")
    with pytest.raises(DeviceError, match="expected a CUDA device and NVIDIA's driver, found none"):
        cuda_driver._open_devices()
