"""The entry point of the process `pinred`; Ctrl-C ends it with one line, even during start-up."""

from __future__ import annotations


def main() -> int:
    """Run the command that the process's arguments name.  Returns its exit code."""
    import os
    import signal

    try:
        from .interrupt import CODE, end, ends_soon, pressed
        from .main import main as run

        with ends_soon():
            try:
                code = run()
            except Exception:
                if pressed():  # C extensions may replace KeyboardInterrupt by ImportError.
                    end()
                raise
        if code == CODE:
            end()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # The command has finished, so ignore Ctrl-C.
    except KeyboardInterrupt:  # Ctrl-C before the imports finished
        os.write(2, b"pinred: interrupted\n")
        os._exit(130)
    return code
