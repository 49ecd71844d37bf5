"""Members whose values are rejected: they become failures, and the others are simulated."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal, TypeAlias, get_args

import numpy as np

from ...common.errors import (
    InputError,
    LoopWarning,
    PinredError,
    RejectedValuesError,
    RejectedWarning,
    ShapeError,
)
from ...scene.scene import Scene
from ...system.coordinates import Indices
from .member_groups import Members
from .member_options import MemberOptions
from .trajectories import Failure

Invalid: TypeAlias = Literal["record", "raise"]
INVALID: tuple[Invalid, ...] = get_args(Invalid)


def separate_rejected(options: MemberOptions, invalid: Invalid) -> tuple[Members, list[Failure]]:
    """Return the members whose values are valid, and the failures of the others.

    Args:
        options: Options of all members.
        invalid: Whether to "record" rejected members as failures, or to "raise" an error.
    Returns:
        The valid members, with their indices among all members, and the failures.
    Raises:
        PinredError: No member is valid, or `invalid` is "raise" and a member is rejected.
    """
    try:
        return options.members(), []
    except PinredError as error:
        if _is_shared(options, error):
            raise
        reasons = _find_rejected(options, np.arange(options.count), error)
        if invalid == "raise" or len(reasons) == options.count:
            first = min(reasons)
            kind = InputError if isinstance(error, RejectedValuesError) else type(error)
            raise kind(f"member {first}: {reasons[first]}") from None
    return _without(options, reasons)


def separate_all_rejected(options: MemberOptions) -> tuple[Members, list[Failure]]:
    """Return the members whose values are valid, perhaps none, and the failures of the others.

    Args:
        options: Options of all members; the options that all share are valid.
    Returns:
        The valid members, with their indices among all members, and the failures.
    Raises:
        ShapeError: An array has a wrong shape.
    """
    try:
        return options.members(), []
    except ShapeError:
        raise
    except PinredError as error:
        reasons = _find_rejected(options, np.arange(options.count), error)
    return _without(options, reasons)


def _without(options: MemberOptions, reasons: dict[int, str]) -> tuple[Members, list[Failure]]:
    """Return the members that are not rejected, and the failures of the rejected ones."""
    failures = [Failure(k, 0.0, reason, rejected=True) for k, reason in sorted(reasons.items())]
    kept = np.setdiff1d(np.arange(options.count), list(reasons))
    if not kept.size:
        return Members(options.count, [], partial(options.scene, common_parameters=True)), failures
    resolved = options.select(kept).members()
    groups = [replace(group, members=kept[group.members]) for group in resolved.groups]
    return Members(options.count, groups, partial(_scene, resolved.scene_of, kept)), failures


def warn_of_rejected(failures: list[Failure], count: int) -> None:
    """Warn that some members were rejected, in one sentence for all."""
    if failures:
        first, reason = failures[0].member, failures[0].reason.rstrip(".")
        warnings.warn(
            f"{len(failures)} of {count} members are rejected and listed in `failures`; the first "
            f"is member {first}: {reason}. Pass invalid='raise' to get an error.",
            RejectedWarning,
            stacklevel=4,
        )


def _is_shared(options: MemberOptions, error: PinredError) -> bool:
    """Return whether an error comes from shapes, or from options that all members share."""
    if isinstance(error, (RejectedValuesError, ShapeError)):
        return isinstance(error, ShapeError)
    alone = [_try_members(options, np.array([k])) for k in {0, options.count - 1}]
    return all(str(error) in reasons.values() for reasons in alone)


def _find_rejected(options: MemberOptions, members: Indices, error: PinredError) -> dict[int, str]:
    """Return {member: reason} of the members that cause an error, found by halving.

    Args:
        options: Options of all members.
        members: Indices of the members that raise the error together.
        error: The error.
    """
    if isinstance(error, RejectedValuesError):
        reasons = {int(members[k]): reason for k, reason in error.reasons.items()}
        others = np.setdiff1d(members, list(reasons))
        return reasons | _try_members(options, others)
    if len(members) == 1:
        return {int(members[0]): str(error)}
    halves = np.array_split(members, 2)
    return _try_members(options, halves[0]) | _try_members(options, halves[1])


def _try_members(options: MemberOptions, members: Indices) -> dict[int, str]:
    if not members.size:
        return {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LoopWarning)  # the run of the valid members warns again
            options.select(members).members()
    except PinredError as error:
        return _find_rejected(options, members, error)
    return {}


def _scene(scene_of: Callable[[int], Scene], kept: Indices, member: int) -> Scene:
    """Return the scene of a member; that of the first valid member for rejected members."""
    k = int(np.searchsorted(kept, member))
    return scene_of(k if k < len(kept) and kept[k] == member else 0)
