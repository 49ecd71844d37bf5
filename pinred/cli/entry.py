"""The entry of the process `pinred`: Ctrl-C ends it in one line, also while it is starting."""

from __future__ import annotations


def main() -> int:
    """Run the command that the process was started for.  Returns its exit code."""
    import signal

    try:
        from .interrupt import ends_soon
        from .main import main as run

        with ends_soon():
            return run()
    except KeyboardInterrupt:
        import os

        os.write(2, b"pinred: interrupted\n")
        return 130
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is ending
