"""Inputs at random for everything that pinred reads, run in children that may crash or hang.

    python tests/helpers/faults.py --long            # 20 000 of each kind
    python tests/helpers/faults.py urdf --count 500 --seed 7

An input passes if it is taken, or refused by an error of pinred's.  What does not is a crash (the
child died), a hang (longer than a time), a traceback (any other error), or silent (it is taken,
and what comes of it is not finite).  Each input is made of its kind, the seed and its number, so
that any can be made again.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import pickle
import select
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import fault_inputs
import numpy as np

from pinred.common.errors import PinredError

LONG = 20_000
_PATIENCE = 20.0  # s for one input
_CHUNK = 200  # inputs of a child

Attempt = Callable[[np.random.Generator, Path], str]


@dataclass
class Tally:
    """Outcomes of inputs, counted, and those that must not be: (number, outcome, about)."""

    counts: Counter[str] = field(default_factory=Counter)
    faults: list[tuple[int, str, str]] = field(default_factory=list)

    def add(self, number: int, outcome: str, about: str) -> None:
        """Count an outcome."""
        self.counts[outcome] += 1
        if outcome not in ("taken", "refused"):
            self.faults.append((number, outcome, about))


def tried(kind: str, count: int, seed: int = 0, first: int = 0) -> Tally:
    """Return the outcomes of inputs of a kind, `count` of them from number `first` on."""
    found, number, last = Tally(), first, first + count
    while number < last:
        for number, outcome, about in _of_child(kind, seed, number, min(number + _CHUNK, last)):  # noqa: B020
            found.add(number, outcome, about)
        number += 1
    return found


def outcome_of(attempt: Attempt, rng: np.random.Generator, folder: Path) -> tuple[str, str]:
    """Return the outcome of one input, and what is to be said about it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            silent = attempt(rng, folder)
    except PinredError as error:
        said = str(error)
        return ("refused", "") if said.strip() else ("traceback", "an error without words")
    except BaseException as error:  # that is what is looked for
        return "traceback", f"{type(error).__name__}: {error}"[:500]
    return ("silent", silent) if silent else ("taken", "")


def _of_child(kind: str, seed: int, first: int, last: int) -> list[tuple[int, str, str]]:
    """Return the outcomes of inputs as far as one child comes, its crash or hang included."""
    reading, writing = os.pipe()
    with warnings.catch_warnings():  # of JAX, where it is imported: the child has no use for it
        warnings.simplefilter("ignore", RuntimeWarning)
        child = os.fork()
    if child == 0:
        os.close(reading)
        _work(kind, seed, first, last, writing)
    os.close(writing)
    said, until = b"", time.monotonic() + _PATIENCE
    hung = False
    with os.fdopen(reading, "rb", buffering=0) as pipe:
        while True:
            ready, _, _ = select.select([pipe], [], [], max(0.0, until - time.monotonic()))
            if not ready:
                hung = True
                os.kill(child, signal.SIGKILL)
                break
            part = pipe.read(65536)
            if not part:
                break
            said, until = said + part, time.monotonic() + _PATIENCE
    _, status = os.waitpid(child, 0)
    found = _unpacked(said)
    if len(found) < last - first:
        number = first + len(found)
        died = "hang" if hung else "crash"
        found.append((number, died, f"status {status}"))
    return found


def _work(kind: str, seed: int, first: int, last: int, writing: int) -> None:
    """Try inputs and write each outcome down.  Ends the process."""
    faulthandler.disable()
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    with tempfile.TemporaryDirectory() as folder:
        for number in range(first, last):
            rng = np.random.default_rng([fault_inputs.NUMBER[kind], seed, number])
            result = outcome_of(fault_inputs.KINDS[kind], rng, Path(folder))
            row = pickle.dumps((number, *result))
            os.write(writing, len(row).to_bytes(4, "big") + row)
    os._exit(0)


def _unpacked(said: bytes) -> list[tuple[int, str, str]]:
    found = []
    while len(said) >= 4:
        size = int.from_bytes(said[:4], "big")
        if len(said) < 4 + size:
            break
        found.append(pickle.loads(said[4 : 4 + size]))
        said = said[4 + size :]
    return found


def main() -> int:
    """Try inputs of the kinds asked for, and print what came of them."""
    parser = argparse.ArgumentParser(description="Try inputs at random.")
    parser.add_argument("kinds", nargs="*", help=", ".join(fault_inputs.KINDS))
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--long", action="store_true", help=f"{LONG} of each kind")
    options = parser.parse_args()
    fault_inputs.prepare()
    wrong = 0
    for kind in options.kinds or fault_inputs.KINDS:
        began = time.monotonic()
        count = LONG if options.long else options.count
        found = tried(kind, count, options.seed, options.first)
        wrong += len(found.faults)
        told = ", ".join(f"{number} {name}" for name, number in sorted(found.counts.items()))
        print(f"{kind:<10} {count} inputs: {told}; {time.monotonic() - began:.0f} s", flush=True)
        seen: set[str] = set()
        for number, outcome, about in found.faults:
            if about[:60] not in seen:
                seen.add(about[:60])
                print(f"  input {number}: {outcome}: {about}", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
