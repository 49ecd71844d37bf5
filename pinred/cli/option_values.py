"""Parsers of the texts of option values: numbers, values by joint, motions of joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from ..common.errors import InputError
from ..common.names import quoted

T = TypeVar("T")


def numbers_in(text: str | None, option: str) -> list[float] | None:
    """Parse the numbers in a text V1,V2,…; None stays None.  Raises InputError."""
    if text is None:
        return None
    try:
        return floats_in(text) if text else []
    except ValueError:
        raise InputError(
            f"--{option} takes numbers separated by commas, got {quoted(text)}"
        ) from None


def assigned_in(
    entries: Sequence[str], option: str, read: Callable[[str], T], usage: str, noun: str = "joint "
) -> dict[str, T]:
    """Parse texts NAME=VALUE.

    Args:
        entries: The texts.
        option: Name of the option, for messages.
        read: Converts the text of a value; raises ValueError if it is invalid.
        usage: Accepted formats, for messages.
        noun: Kind of object that a name denotes, for messages.
    Returns:
        The values by name.
    Raises:
        InputError: A text has another format, or a name occurs twice.
    """
    values: dict[str, T] = {}
    for entry in entries:
        name, _, text = entry.partition("=")
        if name in values:
            raise InputError(f"--{option} has {noun}{quoted(name)} twice")
        try:
            values[name] = read(text if name else "")
        except ValueError:
            raise InputError(f"--{option} takes {usage}, got {quoted(entry)}") from None
    return values


def by_joint_in(text: str, option: str) -> list[float] | dict[str, float]:
    """Parse V1,V2,… into numbers, or J1=V1,… into {joint: number}.  Raises InputError."""
    if "=" not in text:
        return numbers_in(text, option) or []
    return assigned_in(text.split(","), option, float, "numbers, or JOINT=NUMBER for each")


def shape_in(text: str, option: str) -> list[float] | dict[str, float | list[float]]:
    """Parse like `by_joint_in`, where J=V1,V2,V3 has the numbers of a ball."""
    if "=" not in text:
        return numbers_in(text, option) or []
    entries = _joined(text, lambda word: "=" not in word)
    usage = "numbers, or JOINT=NUMBER for each, or JOINT=V1,V2,V3 for a ball"
    return assigned_in(entries, option, _number_or_list, usage)


def _joined(text: str, continues: Callable[[str], bool]) -> list[str]:
    """Split a text at commas, and join the words that continue a word J=V1.

    Args:
        text: The text; empty for no words.
        continues: Predicate of words that may be a further number of the word before.
    Returns:
        The entries J, J=V1 or J=V1,V2,….
    """
    entries: list[str] = []
    for word in text.split(",") if text else ():
        if entries and "=" in entries[-1] and continues(word):
            entries[-1] += f",{word}"
        else:
            entries.append(word)
    return entries


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _number_or_list(text: str) -> float | list[float]:
    return floats_in(text) if "," in text else float(text)


def floats_in(text: str) -> list[float]:
    """Parse a text V1,V2,….  Raises ValueError."""
    return [float(word) for word in text.split(",")]


def spring_in(text: str) -> tuple[float, float]:
    """Parse a text STIFFNESS or STIFFNESS,REST; the rest is zero by default.  Raises ValueError."""
    stiffness, rest = floats_in(text if "," in text else f"{text},0")
    return stiffness, rest


def stop_in(text: str) -> list[float]:
    """Parse a text LOWER,UPPER or LOWER,UPPER,RESTITUTION.  Raises ValueError."""
    numbers = floats_in(text)
    if len(numbers) not in (2, 3):
        raise ValueError
    return numbers


def lock_in(text: str, option: str) -> dict[str, float | list[float]]:
    """Parse J1,J2=VALUE,J3=V1,V2,V3 into {joint: value}, with zero for joints without a value."""
    lock: dict[str, float | list[float]] = {}
    for entry in _joined(text, _is_number):
        name, _, value = entry.partition("=")
        numbers = numbers_in(value, option) or [0.0]
        lock[name] = numbers[0] if len(numbers) == 1 else numbers
    return lock


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
