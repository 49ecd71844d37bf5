"""The entry of the process `pinred`: Ctrl-C ends it in one line, also while it is starting."""

from __future__ import annotations


def main() -> int:
    """Run the command that the process was started for.  Returns its exit code."""
    import os
    import signal

    try:
        from .interrupt import CODE, end, ends_soon, pressed
        from .main import main as run

        with ends_soon():
            try:
                code = run()
            except Exception:
                if pressed():  # modules in C make an ImportError of it
                    end()
                raise
        if code == CODE:
            end()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it has done what it was to do
    except KeyboardInterrupt:  # before there was anything of ours
        os.write(2, b"pinred: interrupted\n")
        os._exit(130)
    return code
