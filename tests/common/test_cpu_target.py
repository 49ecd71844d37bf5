"""Tests of PINRED_CPU and PINRED_CODE_LEVEL, for which machine code is compiled."""

from __future__ import annotations

import ctypes
import platform
from pathlib import Path

import casadi as ca
import llvmlite.binding as llvm
import numpy as np
import pytest

from pinred.common import machine_code as targets
from pinred.common.errors import InputError
from pinred.common.machine_code import cpu_target, load_object
from pinred.common.object_cache import cache_key
from pinred.kernels.machine.native import compile_object

ROOT = Path(__file__).parents[2]
on_x86 = pytest.mark.skipif(platform.machine() != "x86_64", reason="levels of x86-64")


def compile_dot_product() -> bytes:
    """Compile a sum of products, where fused multiply-adds apply."""
    x, y = ca.SX.sym("x", 4), ca.SX.sym("y", 4)
    return compile_object(ca.Function("dot", [x, y], [ca.dot(x, y)]), "dot")


@on_x86
def test_pinned_code_does_not_depend_on_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a level, code and cache key are those of a machine with more features."""
    keys, codes = [], []
    features = dict(llvm.get_host_cpu_features())
    more = llvm.FeatureMap(features | {"avx512f": True, "avx512vl": True})
    for level in ("", "x86-64-v2"):
        monkeypatch.setenv("PINRED_CPU", level)
        for machine in (("znver3", llvm.FeatureMap(features)), ("znver4", more)):
            monkeypatch.setattr(llvm, "get_host_cpu_name", lambda name=machine[0]: name)
            monkeypatch.setattr(llvm, "get_host_cpu_features", lambda has=machine[1]: has)
            targets._target_named.cache_clear()
            keys.append(cache_key("one"))
            codes.append(compile_dot_product())
    targets._target_named.cache_clear()
    assert len(set(keys)) == 3
    assert keys[2] == keys[3]
    assert codes[2] == codes[3]


@on_x86
@pytest.mark.skipif(not llvm.get_host_cpu_features().get("fma"), reason="needs FMA")
def test_level_decides_on_fused_multiply_adds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Level 3 has fused multiply-adds and level 2 has none, in the target and in the code."""
    codes = {}
    for level, fma in (("x86-64-v2", False), ("x86-64-v3", True)):
        monkeypatch.setenv("PINRED_CPU", level)
        assert cpu_target() == (level, "", fma)
        codes[level] = compile_dot_product()
    assert codes["x86-64-v2"] != codes["x86-64-v3"]


@on_x86
def test_unknown_or_unsupported_level_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error lists the levels, or the features that the machine lacks."""
    monkeypatch.setenv("PINRED_CPU", "pentium9")
    with pytest.raises(InputError, match=r"one of x86-64, x86-64-v2, .* got 'pentium9'"):
        cache_key("one")
    monkeypatch.setenv("PINRED_CPU", "x86-64-v4")
    few = llvm.FeatureMap({"avx2": True})
    monkeypatch.setattr(llvm, "get_host_cpu_features", lambda: few)
    targets._target_named.cache_clear()
    with pytest.raises(InputError, match=r"got 'x86-64-v4', but .*avx512f"):
        cpu_target()
    targets._target_named.cache_clear()


def test_code_of_all_levels_agrees_and_is_cached_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Results at level 0 are those of the default but for last bits; keys of caches differ."""
    rng = np.random.default_rng(4)
    x = rng.uniform(-1.0, 1.0, 6)
    symbols = ca.SX.sym("x", 6)
    product = ca.sin(symbols[:3]) * symbols[3:] + ca.cos(symbols[3:]) / (2.0 + symbols[:3])
    function = ca.Function("f", [symbols], [product * product[[1, 2, 0]] - symbols[:3]])
    values, keys = {}, set()
    for level in ("", "0", "1", "2"):
        monkeypatch.setenv("PINRED_CODE_LEVEL", level)
        keys.add(cache_key("f"))
        native = load_object(compile_object(function, "f"), "f")
        out = np.empty(3)
        call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(native.address)
        call(x.ctypes.data, out.ctypes.data)
        values[level] = out
    assert len(keys) == 3
    np.testing.assert_array_equal(values[""], values["1"])
    expected = np.array(function(x)).ravel()
    for out in values.values():
        np.testing.assert_allclose(out, expected, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("level", ["4", "-1", "fast"])
def test_unknown_levels_of_code_are_refused(monkeypatch: pytest.MonkeyPatch, level: str) -> None:
    """The message names the variable, the levels and the default."""
    monkeypatch.setenv("PINRED_CODE_LEVEL", level)
    with pytest.raises(InputError, match="PINRED_CODE_LEVEL: expected 0, 1, 2 or 3, got"):
        cache_key("f")
