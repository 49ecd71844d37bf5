"""Pass random invalid inputs to pinred, in child processes that may crash or hang.

    python tests/helpers/faults.py --long            # 20 000 of each kind
    python tests/helpers/faults.py urdf --count 500 --seed 7

An input passes if pinred accepts it, or rejects it by an error of its own. Four outcomes are
faults: a crash (the child died), a hang (it exceeded a time limit), a traceback (any other
exception), and "silent" (the input was accepted and the result is not finite). Kind, seed and
number determine an input, so each can be reproduced.
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
_PATIENCE = 20.0  # time limit of one input [s]
_CHUNK = 200  # number of inputs per child process

Attempt = Callable[[np.random.Generator, Path], str]


@dataclass
class Tally:
    """Counted outcomes, and the faults as (number, outcome, about)."""

    counts: Counter[str] = field(default_factory=Counter)
    faults: list[tuple[int, str, str]] = field(default_factory=list)

    def add(self, number: int, outcome: str, about: str) -> None:
        """Count an outcome."""
        self.counts[outcome] += 1
        if outcome not in ("taken", "refused"):
            self.faults.append((number, outcome, about))


def tried(kind: str, count: int, seed: int = 0, first: int = 0) -> Tally:
    """Return the outcomes of `count` inputs of a kind, starting at number `first`."""
    tally, number, last = Tally(), first, first + count
    while number < last:
        for number, outcome, about in _of_child(kind, seed, number, min(number + _CHUNK, last)):  # noqa: B020
            tally.add(number, outcome, about)
        number += 1
    return tally


def outcome_of(attempt: Attempt, rng: np.random.Generator, folder: Path) -> tuple[str, str]:
    """Return the outcome of one input and a description of the fault, if any."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            unsound = attempt(rng, folder)
    except PinredError as error:
        message = str(error)
        return ("refused", "") if message.strip() else ("traceback", "an error without a message")
    except BaseException as error:  # any other exception is a fault
        return "traceback", f"{type(error).__name__}: {error}"[:500]
    return ("silent", unsound) if unsound else ("taken", "")


def _of_child(kind: str, seed: int, first: int, last: int) -> list[tuple[int, str, str]]:
    """Return the outcomes of inputs in one child, up to and including a crash or hang."""
    reading, writing = os.pipe()
    with warnings.catch_warnings():  # JAX warns of forks; the child does not use JAX
        warnings.simplefilter("ignore", RuntimeWarning)
        child = os.fork()
    if child == 0:
        os.close(reading)
        _work(kind, seed, first, last, writing)
    os.close(writing)
    received, deadline = b"", time.monotonic() + _PATIENCE
    hung = False
    with os.fdopen(reading, "rb", buffering=0) as pipe:
        while True:
            ready, _, _ = select.select([pipe], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                hung = True
                os.kill(child, signal.SIGKILL)
                break
            data = pipe.read(65536)
            if not data:
                break
            received, deadline = received + data, time.monotonic() + _PATIENCE
    _, status = os.waitpid(child, 0)
    outcomes = _unpacked(received)
    if len(outcomes) < last - first:
        number = first + len(outcomes)
        died = "hang" if hung else "crash"
        outcomes.append((number, died, f"status {status}"))
    return outcomes


def _work(kind: str, seed: int, first: int, last: int, writing: int) -> None:
    """Try inputs and write each outcome to the pipe; then end the process."""
    faulthandler.disable()
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    with tempfile.TemporaryDirectory() as folder:
        for number in range(first, last):
            rng = np.random.default_rng([fault_inputs.NUMBER[kind], seed, number])
            result = outcome_of(fault_inputs.KINDS[kind], rng, Path(folder))
            record = pickle.dumps((number, *result))
            os.write(writing, len(record).to_bytes(4, "big") + record)
    os._exit(0)


def _unpacked(received: bytes) -> list[tuple[int, str, str]]:
    outcomes = []
    while len(received) >= 4:
        size = int.from_bytes(received[:4], "big")
        if len(received) < 4 + size:
            break
        outcomes.append(pickle.loads(received[4 : 4 + size]))
        received = received[4 + size :]
    return outcomes


def main() -> int:
    """Try inputs of the requested kinds and print the outcomes."""
    parser = argparse.ArgumentParser(description="Try inputs at random.")
    parser.add_argument("kinds", nargs="*", help=", ".join(fault_inputs.KINDS))
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--long", action="store_true", help=f"{LONG} of each kind")
    options = parser.parse_args()
    fault_inputs.prepare()
    fault_count = 0
    for kind in options.kinds or fault_inputs.KINDS:
        start = time.monotonic()
        count = LONG if options.long else options.count
        tally = tried(kind, count, options.seed, options.first)
        fault_count += len(tally.faults)
        summary = ", ".join(f"{number} {name}" for name, number in sorted(tally.counts.items()))
        print(f"{kind:<10} {count} inputs: {summary}; {time.monotonic() - start:.0f} s", flush=True)
        printed: set[str] = set()
        for number, outcome, about in tally.faults:
            if about[:60] not in printed:
                printed.add(about[:60])
                print(f"  input {number}: {outcome}: {about}", flush=True)
    return 1 if fault_count else 0


if __name__ == "__main__":
    sys.exit(main())
