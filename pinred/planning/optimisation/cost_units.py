"""Units of the costs of gaits, and of the merits that an optimisation maximises."""

from __future__ import annotations

from ...analysis.connections.connection import Connection
from .objective import DEGREES, AxisAim, CostKind
from .transcription import Task

_ROOTS = {1: "", 2: "√", 4: "⁴√"}


def cost_unit(connection: Connection, kind: CostKind) -> str:
    """Return the unit of a cost, which depends on what the connection's metric measures.

    The metric of momenta gives twice the kinetic energy of a shape rate [J], that of drag the
    dissipated power [W].
    """
    joints = set(connection.form.units)
    torque = "N m" if joints == {"rad"} else "N" if joints == {"m"} else "N m | N"
    is_kinetic = connection.form.momentum
    units = {
        "length": "m √kg" if is_kinetic else "√(J s)",
        "torque": f"({torque})² s",
        "power": "W² s",
        "acceleration": "W" if is_kinetic else "W/s",
        "time": "s",
    }
    return units[kind]


def merit_name(task: Task) -> tuple[str, str]:
    """Return the name and the unit of the merit of a task (see Task.merit)."""
    aim = task.aim
    if not isinstance(aim, AxisAim):
        return f"−{task.cost}", cost_unit(task.connection, task.cost) if task.cost else "1"
    if task.cost is None or not task.per_cost:
        return aim.kind, aim.unit
    root, unit = _ROOTS[DEGREES[task.cost]], cost_unit(task.connection, task.cost)
    per = f"{root}({unit})" if root or (" " in unit and not unit.startswith("√")) else unit
    return f"{aim.kind} / {root}{task.cost}", f"{aim.unit}/{per}"
