"""Measurements that anyone can repeat, by `pinred bench …` or from Python.

    from pinred.bench import bench_accuracy
    for found in bench_accuracy():
        print(found)

Names are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .accuracy import Point, WorkPrecision, bench_accuracy
    from .kernels import KernelTiming, bench_kernels
    from .many import ManyTiming, bench_many
    from .methods import METHODS, End, Method, Prepared
    from .problems import Problem, default_problems
    from .scaling import Scaling, bench_scaling

_HOME = {
    **dict.fromkeys(("Point", "WorkPrecision", "bench_accuracy"), "accuracy"),
    **dict.fromkeys(("KernelTiming", "bench_kernels"), "kernels"),
    **dict.fromkeys(("ManyTiming", "bench_many"), "many"),
    **dict.fromkeys(("METHODS", "End", "Method", "Prepared"), "methods"),
    **dict.fromkeys(("Problem", "default_problems"), "problems"),
    **dict.fromkeys(("Scaling", "bench_scaling"), "scaling"),
}

__all__ = [
    "METHODS",
    "End",
    "KernelTiming",
    "ManyTiming",
    "Method",
    "Point",
    "Prepared",
    "Problem",
    "Scaling",
    "WorkPrecision",
    "bench_accuracy",
    "bench_kernels",
    "bench_many",
    "bench_scaling",
    "default_problems",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return __all__
