"""`python -m pinred` is `pinred`."""

import sys

from .cli import main

sys.exit(main())
