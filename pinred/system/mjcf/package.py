"""Import of the package mujoco, only when needed; the extra `mjcf` installs it."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ...common.optional_packages import install_command, optional_package

INSTALL = install_command("mjcf")


def mujoco_package() -> Any:
    """Return the module mujoco.  Raises MissingPackageError with the command that installs it."""
    return optional_package("mujoco", f"MJCF is read by MuJoCo's compiler: {INSTALL}")


@contextmanager
def warnings_kept() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings; by default, MuJoCo writes them to a file in the current folder."""
    mj = mujoco_package()
    messages: list[str] = []
    before = mj.get_mju_user_warning()
    mj.set_mju_user_warning(messages.append)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield messages
            messages += [str(warning.message) for warning in caught]
    finally:
        mj.set_mju_user_warning(before)
