"""Machine code of a flow's derivatives that other threads generate before it is needed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.common import object_cache
from pinred.kernels import build
from pinred.kernels.machine.native import lowered


@pytest.mark.parametrize("method", ["DOP853", "Gauss(0.05)"])
def test_derivatives_use_the_code_that_is_expected(
    method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With an empty cache, several codes are generated ahead, and each of them is used."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))
    for module in (object_cache, build):
        monkeypatch.setattr(module, "spare_processors", lambda: 1)
    begun: list[Any] = []
    begin_ahead = object_cache.begin_ahead

    def begin(ahead: object_cache.ObjectAhead) -> None:
        begun.append(ahead)
        begin_ahead(ahead)

    monkeypatch.setattr(object_cache, "begin_ahead", begin)
    robot = pinred.load("elroys_beanie")
    end = pinred.flow(robot, wrt=["x0", "xdot0"], seed=1, duration=0.1, method=method)
    for derivative in (
        end.jacobian,
        lambda: end.vjp({"pose": np.ones(robot.group.dim)}),
        lambda: end.jvp({"x0": np.ones(1)}),
    ):
        derivative()
        assert not [key for folder, key in object_cache._ahead if folder == tmp_path]
    assert len(begun) >= 5


def test_lowered_function_has_to_compile() -> None:
    """A function that compiles nothing has no LLVM code."""
    with pytest.raises(RuntimeError, match="does not call compile_object"):
        lowered(lambda: b"")
