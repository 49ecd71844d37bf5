"""The methods whose accuracy is measured.  A further one is one more entry of SOLVERS."""

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
# With what takes minutes to prepare.
ALL_SOLVERS: tuple[Solver, ...] = (*OWN, *ABA, *MUJOCO, *EXUDYN, *DRAKE, *CVODES, *HEYOKA_SLOW)


def solvers_named(
    names: Sequence[str] | None, among: Sequence[Solver] = SOLVERS
) -> tuple[Solver, ...]:
    """Return the methods of these names, all if None.  Raises InputError listing them."""
    if names is None:
        return tuple(among)
    found = {method.name: method for method in among}
    for name in names:
        if name not in found:
            raise InputError(f"no method '{name}'; they are {', '.join(found)}")
    return tuple(found[name] for name in dict.fromkeys(names))
