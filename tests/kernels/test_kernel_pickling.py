"""Tests that machine code is neither copied nor pickled, and that llvmlite prints nothing."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pinred
from pinred.kernels.build import build_kernel
from pinred.kernels.kernel import Kernel
from pinred.simulation.plan import plan_of

ROOT = Path(__file__).parents[2]


def kernel() -> Kernel:
    """Return a kernel."""
    cat = pinred.load("falling_cat")
    plan = plan_of(pinred.Scene(system=cat))
    return build_kernel(cat, plan.structure(zero_momentum=False))


@pytest.mark.parametrize("how", [pickle.dumps, copy.deepcopy, copy.copy])
def test_copy_of_machine_code_raises_not_copyable(how: Callable[[Any], Any]) -> None:
    """The message names the code and suggests alternatives."""
    with pytest.raises(pinred.NotCopyable, match=r"'rate' lives in this process.*load"):
        how(kernel().rate)


QUIET = """
import copy, gc, pickle, threading
import pinred
from pinred.kernels.build import build_kernel

cat = pinred.load("falling_cat")

def work(number):
    for k in range(3):
        own = pinred.load("falling_cat")
        traj = pinred.simulate(own, duration=0.05, springs={"bend": (1.0 + number, 0.1)})
        kernel = build_kernel(own, traj.plan.structure(zero_momentum=False), traj.plan.forces)
        for thing in (traj, own, cat, kernel, kernel.rate, list(vars(own)["_once"].values())[::-1]):
            for how in (pickle.dumps, copy.deepcopy):
                try:
                    how(thing)
                except Exception:
                    pass
        del own, traj, kernel, thing
        gc.collect()

threads = [threading.Thread(target=work, args=(n,)) for n in range(6)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
"""


@pytest.mark.by_hand
def test_dropped_kernels_print_nothing(tmp_path: Path) -> None:
    """Threads that build and drop kernels print nothing, even after failed copies."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", QUIET], cwd=ROOT, capture_output=True, text=True,
        check=False, env={"PATH": "", "PINRED_CACHE_DIR": str(tmp_path)},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
