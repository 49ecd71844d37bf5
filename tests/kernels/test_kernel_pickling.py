"""Machine code is not copied: what tries is told so, and llvmlite prints nothing of its own."""

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
    """A kernel."""
    cat = pinred.load("falling_cat")
    plan = plan_of(pinred.Scene(system=cat))
    return build_kernel(cat, plan.kind(zero_momentum=False).structure)


@pytest.mark.parametrize("how", [pickle.dumps, copy.deepcopy, copy.copy])
def test_machine_code_says_that_it_cannot_be_copied(how: Callable[[Any], Any]) -> None:
    """By name, and with what to do instead."""
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
        kernel = build_kernel(own, traj.plan.kind(zero_momentum=False).structure, traj.plan.forces)
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


@pytest.mark.slow
def test_nothing_is_printed_when_kernels_go(tmp_path: Path) -> None:
    """Not in threads that make and drop kernels, nor after copies and pickles that failed."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", QUIET], cwd=ROOT, capture_output=True, text=True,
        check=False, env={"PATH": "", "PINRED_CACHE_DIR": str(tmp_path)},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
