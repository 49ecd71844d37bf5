"""Entry point of `python -m pinred`, the same as the command `pinred`."""

import sys

from .cli.entry import main

sys.exit(main())
