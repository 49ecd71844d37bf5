"""The package mujoco, which is installed with the extra `mjcf` and imported when needed."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from ...common.errors import MissingPackageError

INSTALL = 'pip install "pinred[mjcf]"'


def mujoco_package() -> Any:
    """Return the module mujoco.  Raises MissingPackageError that says what to install."""
    try:
        return import_module("mujoco")
    except ImportError:
        raise MissingPackageError(f"MJCF is read by MuJoCo's compiler: {INSTALL}") from None


def is_mujoco(source: object, kind: str) -> bool:
    """Return whether an object is mujoco's MjModel or MjSpec, without importing mujoco."""
    made_by = type(source).__module__.partition(".")[0]
    return made_by == "mujoco" and type(source).__name__ == kind


@contextmanager
def warnings_kept() -> Iterator[list[str]]:
    """Collect what MuJoCo warns of, which it would write into a file in the current folder."""
    mj = mujoco_package()
    said: list[str] = []
    before = mj.get_mju_user_warning()
    mj.set_mju_user_warning(said.append)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield said
            said += [str(warning.message) for warning in caught]
    finally:
        mj.set_mju_user_warning(before)
