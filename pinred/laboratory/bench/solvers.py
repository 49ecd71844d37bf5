"""The methods of the accuracy benchmark; add a method to SOLVERS."""

from __future__ import annotations

from collections.abc import Sequence

from ...common.errors import InputError
from .peers.aba import ABA
from .peers.cvodes import CVODES
from .peers.drake import DRAKE
from .peers.exudyn import EXUDYN
from .peers.heyoka import HEYOKA, HEYOKA_SLOW
from .peers.mujoco import MUJOCO
from .pinred_methods import OWN
from .solver import Solver

SOLVERS: tuple[Solver, ...] = (*OWN, *ABA, *MUJOCO, *EXUDYN, *DRAKE, *CVODES, *HEYOKA)
# ALL_SOLVERS also includes methods whose preparation takes minutes.
ALL_SOLVERS: tuple[Solver, ...] = (*OWN, *ABA, *MUJOCO, *EXUDYN, *DRAKE, *CVODES, *HEYOKA_SLOW)


def solvers_named(
    names: Sequence[str] | None, among: Sequence[Solver] = SOLVERS
) -> tuple[Solver, ...]:
    """Return the named methods, or all if None; raise InputError for an unknown name."""
    if names is None:
        return tuple(among)
    by_name = {method.name: method for method in among}
    for name in names:
        if name not in by_name:
            raise InputError(f"no method '{name}'; the methods are {', '.join(by_name)}")
    return tuple(by_name[name] for name in dict.fromkeys(names))
