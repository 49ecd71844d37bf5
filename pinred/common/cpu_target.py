"""The CPU that all machine code is compiled for: this machine's, or the one PINRED_CPU names.

Code for different CPUs differs in its fused multiply-adds, and so in round-off.  With the same
PINRED_CPU, machines compile the same code.
"""

from __future__ import annotations

import os
import platform
from functools import cache
from typing import NamedTuple

import llvmlite.binding as llvm

from .errors import InputError

VARIABLE = "PINRED_CPU"
# Code generation at level 1 emits code of the same results and speed in a tenth less time than 2.
LEVEL = 1
_LEVEL_VARIABLE = "PINRED_CODE_LEVEL"
_V2 = ("cx16", "popcnt", "sahf", "sse3", "sse4.1", "sse4.2", "ssse3")
_V3 = (*_V2, "avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
_V4 = (*_V3, "avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl")
# CPU names of LLVM, and the features that each needs beyond the architecture's baseline.
_X86 = {"x86-64": (), "x86-64-v2": _V2, "x86-64-v3": _V3, "x86-64-v4": _V4}
_ARM: dict[str, tuple[str, ...]] = {"generic": ()}
_WITH_FMA = {"x86-64-v3", "x86-64-v4", "generic"}  # `generic` is aarch64, where all have it


class CPUTarget(NamedTuple):
    """A CPU as LLVM describes it.

    Attributes:
        name: LLVM's name of the CPU.
        features: Features added to those of the name, in LLVM's format.
        fma: Whether the CPU has a fused multiply-add.
    """

    name: str
    features: str
    fma: bool


def cpu_target() -> CPUTarget:
    """Return the CPU that machine code is compiled for.

    Returns:
        The CPU that the environment variable PINRED_CPU names, or this machine's.
    Raises:
        InputError: PINRED_CPU is unknown, or this machine lacks some of its features.
    """
    return _target_named(os.environ.get(VARIABLE, ""))


def code_level() -> int:
    """Return LLVM's level of optimisation in the code generation of kernels.

    Level 0 takes a third of the time of level 1.  Its code is slower, and fuses fewer products and
    sums, so that last bits differ.

    Returns:
        The level that the environment variable PINRED_CODE_LEVEL states, or `LEVEL`.
    Raises:
        InputError: PINRED_CODE_LEVEL is unknown.
    """
    text = os.environ.get(_LEVEL_VARIABLE, "") or str(LEVEL)
    if text not in ("0", "1", "2", "3"):
        raise InputError(
            f"{_LEVEL_VARIABLE}: expected 0, 1, 2 or 3, got {text!r}. Unset it for {LEVEL}"
        )
    return int(text)


@cache
def _target_named(name: str) -> CPUTarget:
    features = llvm.get_host_cpu_features()
    is_arm = platform.machine().lower() in {"arm64", "aarch64"}
    if not name:
        fma = is_arm or bool(features.get("fma"))
        return CPUTarget(llvm.get_host_cpu_name(), features.flatten(), fma)
    targets = _ARM if is_arm else _X86
    if name not in targets:
        raise InputError(
            f"{VARIABLE}: expected one of {', '.join(targets)}, got {name!r}. "
            "Unset it to compile for this machine"
        )
    missing = [feature for feature in targets[name] if not features.get(feature)]
    if missing:
        raise InputError(
            f"{VARIABLE}: expected a CPU whose features this machine has, got {name!r}, but "
            f"{', '.join(missing)} are missing. Use the newest level that all machines have"
        )
    return CPUTarget(name, "", name in _WITH_FMA)
