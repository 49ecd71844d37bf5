"""Measurements that anyone can repeat, by `pinred bench …` or from Python.

    from pinred.verification.bench import bench_accuracy
    for found in bench_accuracy():
        print(found)

Names are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .accuracy import DEFAULT, FULL, QUICK, Effort, bench_accuracy
    from .evaluations import Evaluations, bench_evaluations
    from .kernels import KernelTiming, bench_kernels
    from .own_methods import own_method
    from .problems import Problem
    from .record import read_record, write_record
    from .reference import Reference, reference_of
    from .scaling import Scaling, bench_scaling
    from .scenes import SCENES, problems_named
    from .solver import End, Method, Prepared
    from .solvers import METHODS
    from .threads import ManyTiming, bench_many
    from .work_precision import Point, WorkPrecision

_HOME = {
    **dict.fromkeys(("DEFAULT", "FULL", "QUICK", "Effort", "bench_accuracy"), "accuracy"),
    **dict.fromkeys(("KernelTiming", "bench_kernels"), "kernels"),
    **dict.fromkeys(("ManyTiming", "bench_many"), "threads"),
    **dict.fromkeys(("End", "Method", "Prepared"), "solver"),
    **dict.fromkeys(("Evaluations", "bench_evaluations"), "evaluations"),
    "METHODS": "solvers",
    "own_method": "own_methods",
    "Problem": "problems",
    **dict.fromkeys(("read_record", "write_record"), "record"),
    **dict.fromkeys(("Reference", "reference_of"), "reference"),
    **dict.fromkeys(("Scaling", "bench_scaling"), "scaling"),
    **dict.fromkeys(("SCENES", "problems_named"), "scenes"),
    **dict.fromkeys(("Point", "WorkPrecision"), "work_precision"),
}

__all__ = [
    "DEFAULT",
    "FULL",
    "METHODS",
    "QUICK",
    "SCENES",
    "Effort",
    "End",
    "Evaluations",
    "KernelTiming",
    "ManyTiming",
    "Method",
    "Point",
    "Prepared",
    "Problem",
    "Reference",
    "Scaling",
    "WorkPrecision",
    "bench_accuracy",
    "bench_evaluations",
    "bench_kernels",
    "bench_many",
    "bench_scaling",
    "own_method",
    "problems_named",
    "read_record",
    "reference_of",
    "write_record",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return __all__
