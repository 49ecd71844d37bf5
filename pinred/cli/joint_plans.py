"""Parsers of prescribed joint motions and of controls on the command line."""

from __future__ import annotations

from typing import Any


def parse_plan(text: str) -> Any:
    """Parse the motion of a joint.

    Args:
        text: A number or a formula in t; for a ball three of these, separated by commas, and
            optionally its centre behind "@".
    Returns:
        The number, the formula, a list of these, or an Attitude.
    Raises:
        ValueError: A part of the text is empty, or the centre is not a list of numbers.
    """
    from ..forces.signals import Attitude

    text, has_centre, centre = text.partition("@")
    parts = _split_outside_brackets(text)
    values = [number_or_formula(part) for part in parts]
    if has_centre:
        return Attitude(values, [float(number) for number in centre.split(",")])
    return values if len(values) > 1 else values[0]


def _split_outside_brackets(text: str) -> list[str]:
    """Split a text at the commas that are not inside of brackets."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter in "([") - (letter in ")]")
        if letter == "," and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def number_or_formula(text: str) -> float | str:
    """Parse a number, or return the text of a formula.  Raises ValueError if it is empty."""
    try:
        return float(text)
    except ValueError:
        if not text:
            raise
        return text
