"""Lines tell a user who waits what pinred does: after a second, or every ten seconds in a pipe."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pinred
from pinred.common import waiting
from pinred.common.compile_notice import notice_of_compiling
from pinred.common.progress import ProgressBar, shown
from pinred.common.waiting import Wait
from pinred.sweeps.sweep import PointsDone

ROOT = Path(__file__).parents[2]


class Clock:
    """A clock that tests turn, and the lines that are due at its times."""

    now = 1000.0

    def lines(self, seconds: float) -> list[tuple[float, str]]:
        """Turn the clock in steps of a tenth of a second; return the times and lines."""
        found, start = [], self.now
        for _ in range(round(10.0 * seconds)):
            self.now = round(self.now + 0.1, 1)
            lines = [waits[-1].due_line(waits[0]) for waits in waiting._open.values()]
            found += [(round(self.now - start, 1), line.strip()) for line in lines if line]
        return found


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Return a clock; no thread writes lines."""
    clock = Clock()
    monkeypatch.setattr(waiting, "time", type("time", (), {"monotonic": lambda: clock.now}))
    monkeypatch.setattr(waiting, "_open", {})
    monkeypatch.setattr(waiting, "_watcher", object())
    monkeypatch.setattr(waiting, "_last_line", 0.0)
    return clock


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pretend that somebody watches."""
    monkeypatch.setattr(waiting, "is_watched", lambda: True)


@pytest.mark.usefixtures("watched")
def test_watched_work_is_stated_after_a_second_and_every_ten(clock: Clock) -> None:
    """Short work is never stated; inner work is stated in place of outer work."""
    with Wait("is quick"):
        assert clock.lines(0.9) == []
    with Wait("computes"):
        assert clock.lines(12.0) == [(1.0, "pinred computes"), (11.0, "pinred computes (11 s)")]
        with Wait("compiles"):
            assert clock.lines(1.5) == [(1.0, "pinred compiles")]
        assert clock.lines(9.0) == [(7.5, "pinred computes (21 s)")]
    assert clock.lines(20.0) == []


def test_pipe_has_a_line_every_ten_seconds(clock: Clock) -> None:
    """The innermost work is stated every ten seconds, however short its parts are."""
    with Wait("computes"):
        assert clock.lines(9.0) == []
        found = []
        for part in range(5):
            with Wait(f"does part {part}"):
                found += clock.lines(3.0)
    assert found == [(1.0, "pinred does part 0"), (2.0, "pinred does part 3")]


def test_bar_without_screen_states_its_percentage(clock: Clock) -> None:
    """With progress=True in a pipe, and without progress for work that reports it."""
    bars: list[Callable[[], Any]] = [
        lambda: ProgressBar("film   ", what="renders a film"),
        lambda: shown(None, "film", what="renders a film", reports=True),
    ]
    for bar in bars:
        with bar() as report:
            report(0.25)
            assert clock.lines(10.5) == [(10.0, "pinred renders a film: 25 %")]
            report(0.5)
            assert clock.lines(10.0) == [(9.5, "pinred renders a film: 50 % (20 s)")]


def test_progress_false_is_silent(clock: Clock) -> None:
    """None states long work, and False does not."""
    with shown(False, "reduced", what="simulates 'cat'"):
        assert clock.lines(30.0) == []
    with shown(None, "reduced", what="simulates 'cat'") as report:
        assert report is None
        assert clock.lines(10.0) == [(10.0, "pinred simulates 'cat'")]


def test_decorated_function_states_each_call(clock: Clock) -> None:
    """Recursive calls are separate waits, and an exception ends all of them."""

    @Wait("recurses")
    def function(depth: int) -> None:
        if depth:
            function(depth - 1)
        assert len(next(iter(waiting._open.values()))) == 3 - depth
        raise KeyError

    with pytest.raises(KeyError):
        function(2)
    assert waiting._open == {}
    assert clock.lines(11.0) == []


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: pinred.simulate(pinred.load("elroys_beanie"), duration=0.1), "simulates"),
        (lambda: pinred.load("elroys_beanie"), "reads a robot"),
        (lambda: pinred.inspect(pinred.load("elroys_beanie")), "inspects a robot"),
        (
            lambda: pinred.compare(pinred.simulate(pinred.load("elroys_beanie"), duration=0.1)),
            "compares",
        ),
        (
            lambda: pinred.simulate_many(pinred.load("elroys_beanie"), duration=0.1, seeds=[1, 2]),
            "simulates 2 members",
        ),
    ],
)
def test_public_functions_state_what_they_do(
    call: Callable[[], Any], what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each long function opens a wait with its description."""
    seen: list[str] = []
    enter = Wait.__enter__

    def spy(wait: Wait) -> Wait:
        seen.append(wait._what if isinstance(wait._what, str) else wait._what())
        return enter(wait)

    monkeypatch.setattr(Wait, "__enter__", spy)
    call()
    assert any(text.startswith(what) for text in seen), seen


def test_resumed_sweep_says_where_it_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The number of stored points and of all points is stated; a new sweep says nothing."""
    monkeypatch.setattr(waiting, "_IS_QUIET", False)
    scene = pinred.Scene(system=pinred.load("elroys_beanie"), duration=0.1, seed=1)
    joint, finished = scene.system.shape_names[0], PointsDone.finished

    def run() -> Any:
        points = {f"x0.{joint}": "Uniform(-1, 1)"}
        return pinred.sweep(scene, points, points=3000, block=1000, store=tmp_path / "s.zarr")

    def interrupted(done: Any, index: int) -> None:
        finished(done, index)
        if done.count == 2000:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(PointsDone, "finished", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run()
    assert capsys.readouterr().err == ""
    run()
    assert "continuing at 2,000 of 3,000 points" in capsys.readouterr().err
    run()  # the store is complete
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(waiting, "_IS_QUIET", True)
    waiting.say("continuing")
    assert capsys.readouterr().err == ""


WORK = """
import os, time
from pinred.common import waiting
waiting._EVERY, waiting._TICK = 0.1, 0.02
with waiting.Wait("works"):
    time.sleep(1.0)
    if os.fork() == 0:
        with waiting.Wait("works in a child"):
            time.sleep(0.5)
        os._exit(0)
    os.wait()
"""


def test_thread_writes_lines_to_a_pipe_and_after_a_fork() -> None:
    """A process and its child write lines while they work."""
    command = [sys.executable, "-W", "ignore", "-c", WORK]
    loud = {name: value for name, value in os.environ.items() if name != "PINRED_QUIET"}
    errors = [
        subprocess.run(
            command, cwd=ROOT, env=env, capture_output=True, text=True, check=True
        ).stderr
        for env in (loud, {**loud, "PINRED_QUIET": "1"})
    ]
    assert "pinred works\n" in errors[0]
    assert "pinred works in a child\n" in errors[0]
    assert errors[1] == ""


def test_thread_ends_without_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread ends soon after the last wait, and another wait starts another thread."""
    monkeypatch.setattr(waiting, "_TICK", 0.001)
    monkeypatch.setattr(waiting, "_IS_QUIET", False)
    for _ in range(2):
        with Wait("works"):
            watcher = waiting._watcher
            assert watcher is not None
        watcher.join(10.0)
        assert not watcher.is_alive()
        assert waiting._watcher is None


def test_compilations_are_announced() -> None:
    """The notice names what is compiled, and says that the result is kept."""
    with notice_of_compiling("the equations of 'cat'") as wait:
        assert str(wait._what).startswith("compiles the equations of 'cat'; the next process")
