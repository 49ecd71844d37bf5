"""Lines and progress bars tell a user who waits what pinred does."""

from __future__ import annotations

import asyncio
import os
import pty
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

import pinred
from pinred.common import waiting
from pinred.common.waiting import ProgressBar, Wait, notice_of_compiling, shown
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


CLEAR = "\r\033[K"
WORK_WITH_BAR = """
import time
from pinred.common.waiting import ProgressBar

try:
    with ProgressBar("falling <b>") as bar:
        bar(0.1)  # too early for a bar
        time.sleep(0.6)
        bar(0.5)
        bar(0.6)  # too soon after the last redraw
        time.sleep(0.2)
        bar(0.75)
        raise KeyboardInterrupt
except KeyboardInterrupt:
    pass
"""


def test_progress_bar_in_terminal_is_cleared_at_the_end() -> None:
    """The bar is drawn in one line of a real terminal, and an interrupt clears it."""
    ours, theirs = pty.openpty()
    try:
        done = subprocess.run(
            [sys.executable, "-c", WORK_WITH_BAR],
            cwd=ROOT,
            stderr=theirs,
            capture_output=False,
            check=True,
        )
        written = os.read(ours, 65536).decode()
    finally:
        os.close(ours)
        os.close(theirs)
    assert done.returncode == 0
    first, *frames, last = written.split(CLEAR)
    assert first == last == "", written
    assert frames == [
        f"falling <b> {'█' * 15}{'·' * 15}  50 %",
        f"falling <b> {'█' * 22}{'·' * 8}  75 %",
    ]


def test_progress_bar_in_pipe_writes_nothing() -> None:
    """If standard error is not a terminal, it receives no output."""
    done = subprocess.run(
        [sys.executable, "-c", WORK_WITH_BAR],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout + done.stderr == ""


CELLS = (
    # 0: a bar that stays open, so that the test can read it
    """
    import time
    from pinred.common.waiting import ProgressBar
    print("before")
    bar = ProgressBar("falling <b>").__enter__()
    time.sleep(0.6)
    bar(0.5)
    time.sleep(0.2)
    bar(0.75)
    print("after")
    """,
    # 1: closing it changes the output of the cell above
    "bar.__exit__(None, None, None)",
    # 2: public functions, without the initial delay, so that short work shows a bar
    """
    import pinred, pinred.common.waiting
    pinred.common.waiting._DRAW_AFTER = pinred.common.waiting._REDRAW = 0.0
    pinred.common.waiting._PATIENCE = 600.0  # Caches may be empty.
    cat = pinred.load("falling_cat")
    traj = pinred.simulate(cat, duration=0.5, progress=True)
    """,
    "pinred.compare(traj, progress=True)",
    # 4: short work leaves no output
    """
    pinred.common.waiting._DRAW_AFTER = 60.0
    traj = pinred.simulate(cat, duration=0.5, progress=True)
    """,
)


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """Run the cells in a real notebook kernel; record the first cell's outputs after each cell."""
    v4: Any = nbformat.v4  # without types
    cells = [v4.new_code_cell(textwrap.dedent(text).strip()) for text in CELLS]
    client = NotebookClient(
        v4.new_notebook(cells=cells),
        timeout=120,
        kernel_name="python3",
        resources={"metadata": {"path": str(ROOT)}},
    )
    home = str(tmp_path_factory.mktemp("jupyter"))
    outputs: dict[str, list[Any]] = {}

    async def run() -> None:
        async with client.async_setup_kernel(env={**os.environ, "IPYTHONDIR": home}):
            for k, cell in enumerate(cells):
                await client.async_execute_cell(cell, k)
                outputs[str(k)] = [dict(output) for output in cell.outputs]
                outputs[f"first after {k}"] = [dict(output) for output in cells[0].outputs]

    asyncio.run(run())
    return outputs


@pytest.mark.by_hand
def test_progress_bar_in_notebook_updates_one_output(outputs: dict[str, list[Any]]) -> None:
    """One output of the cell is updated in place, with an escaped title."""
    before, bar, after = outputs["0"]
    assert (before["text"], after["text"]) == ("before\n", "after\n")
    assert bar["output_type"] == "display_data"
    assert bar["data"]["text/plain"] == f"falling <b> {'█' * 22}{'·' * 8}  75 %"
    html = bar["data"]["text/html"]
    assert '<progress value="0.750" max="1"></progress> 75 %' in html
    assert "falling &lt;b&gt;" in html


@pytest.mark.by_hand
@pytest.mark.slow
def test_progress_bar_in_notebook_is_emptied_at_the_end(outputs: dict[str, list[Any]]) -> None:
    """The bar's output becomes empty, and the cell's other outputs stay."""
    before, bar, after = outputs["first after 1"]
    assert (before["text"], after["text"]) == ("before\n", "after\n")
    assert bar["data"] == {"text/plain": "", "text/html": ""}


def test_functions_with_progress_leave_empty_output(outputs: dict[str, list[Any]]) -> None:
    """Functions draw a bar and leave an empty output; a report shows as a table."""
    (bar,) = outputs["2"]
    assert bar["data"] == {"text/plain": "", "text/html": ""}
    bar, report = outputs["3"]
    assert bar["data"] == {"text/plain": "", "text/html": ""}
    assert report["output_type"] == "execute_result"
    assert "PASSED" in report["data"]["text/html"]
    assert outputs["4"] == []


@pytest.mark.slow
def test_progress_accepts_flags_and_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    """True draws a bar, None and False do not, a function is called, others are rejected."""
    drawn: list[tuple[str, float]] = []

    class Screen:
        def draw(self, title: str, part: float, _pace: str) -> None:
            drawn.append((title, part))

        def clear(self) -> None:
            drawn.append(("cleared", 1.0))

    monkeypatch.setattr(waiting, "_screen", Screen)
    monkeypatch.setattr(waiting, "_DRAW_AFTER", 0.0)
    monkeypatch.setattr(waiting, "_REDRAW", 0.0)
    system = pinred.load("elroys_beanie")
    for engine in ("compiled", "pinocchio"):
        drawn.clear()
        traj = pinred.simulate(system, duration=1.0, engine=engine, progress=True)
        assert drawn[0][0] == "reduced"
        assert drawn[-2:] == [("reduced", 1.0), ("cleared", 1.0)]
    drawn.clear()
    pinred.compare(traj, progress=True)
    assert drawn[-2:] == [("full", 1.0), ("cleared", 1.0)]
    drawn.clear()
    parts: list[float] = []
    pinred.simulate(system, duration=1.0, progress=parts.append)
    pinred.compare(traj, progress=parts.append)
    assert parts.count(1.0) == 2
    pinred.simulate(system, duration=1.0, progress=False)
    pinred.compare(traj)
    assert drawn == []
    for wrong in (1, "yes", 0.5):
        with pytest.raises(pinred.InputError, match="progress must be True or a function"):
            pinred.simulate(system, duration=1.0, progress=wrong)  # type: ignore[arg-type]


def test_bar_shows_rate_and_remaining_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rate counts only what was done since the start, in terminals and notebooks."""
    now = [100.0]
    lines: list[str] = []

    class Screen:
        def draw(self, _title: str, _part: float, pace: str) -> None:
            lines.append(pace)

        def clear(self) -> None:
            pass

    monkeypatch.setattr(waiting, "_screen", Screen)
    monkeypatch.setattr("pinred.common.waiting.time.monotonic", lambda: now[0])
    with waiting.ProgressBar("sweep", 1000, "points") as bar:
        for elapsed, part in ((0.0, 0.5), (10.0, 0.6), (20.0, 0.95), (30.0, 1.0)):
            now[0] = 100.0 + elapsed
            bar(part)
    assert lines == [
        ", 10 points/s, 40 s left", ", 22.5 points/s, 2 s left", ", 16.7 points/s, 0 s left",
    ]  # fmt: skip
    assert waiting._duration(3725.0) == "1 h 02 min"
    assert waiting._duration(125.0) == "2 min 05 s"


def test_long_work_warns_once_of_its_remaining_time() -> None:
    """The estimate is that of the completed fraction, after some seconds."""
    from pinred.common.waiting import LongRunNotice

    now = [0.0]
    notice = LongRunNotice("1e8 steps", lambda: now[0])
    for seconds, part in ((0.1, 0.001), (3.0, 0.0)):
        now[0] = seconds
        notice(part)
    with pytest.warns(UserWarning, match=r"^1e8 steps: 1 % took 3 s, .* takes about 4 min 57 s\."):
        notice(0.01)
    notice(0.02)
    now[0] = 0.0
    short = LongRunNotice("1e8 steps", lambda: now[0])
    now[0] = 3.0
    short(0.2)


def test_many_equal_steps_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The notice changes no number, and runs of fewer steps have none."""
    from pinred.simulation import simulate as module

    cat = pinred.load("falling_cat")
    options: dict[str, Any] = {"duration": 0.1, "xdot0": [0.1, 0.2, 0.3], "momentum": 0}
    plain = pinred.simulate(cat, method=pinred.Gauss(step=1e-4), **options)
    monkeypatch.setattr("pinred.common.waiting._NOTICE_AFTER", 0.0)
    monkeypatch.setattr("pinred.common.waiting._LONG_WORK", 0.0)
    pinred.simulate(cat, method=pinred.Gauss(step=1e-4), **options)
    monkeypatch.setattr(module, "_MANY_STEPS", 100)
    with pytest.warns(UserWarning, match=r"Gauss: 1e\+03 steps of 0\.0001 s are a long run"):
        noticed = pinred.simulate(cat, method=pinred.Gauss(step=1e-4), **options)
    assert np.array_equal(noticed.x, plain.x)
    assert not np.array_equal(noticed.x[0], noticed.x[-1])
