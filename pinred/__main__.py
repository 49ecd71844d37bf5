"""`python -m pinred` is `pinred`."""

import sys

from .cli.entry import main

sys.exit(main())
