"""Options of limits of joints, and the words in which they are given."""

from __future__ import annotations

import argparse

from ..common.errors import InputError
from .options import by_joint_in

_FORM = "R, R1,R2,… or J1=R1,…"


def add_limits(sub: argparse.ArgumentParser) -> None:
    """Add limits of joints, speeds and torques."""
    sub.add_argument(
        "--limits", metavar=_FORM, help="joints stay in [-R, R] [rad | m]; those of the file"
    )
    sub.add_argument("--speeds", metavar=_FORM, help="greatest speeds [rad/s | m/s]")
    sub.add_argument("--torques", metavar=_FORM, help="greatest torques [N m | N]")


def limits_in(options: argparse.Namespace) -> dict[str, float | list[float] | dict[str, float]]:
    """Return the limits given, by the names that Python has for them."""
    out: dict[str, float | list[float] | dict[str, float]] = {}
    for name in ("limits", "speeds", "torques"):
        text = getattr(options, name)
        if text is None:
            continue
        values = by_joint_in(text, name)
        if not values:
            raise InputError(f"--{name} takes {_FORM}, got nothing")
        out[name] = values[0] if isinstance(values, list) and len(values) == 1 else values
    return out
