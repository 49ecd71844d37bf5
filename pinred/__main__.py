"""`python -m pinred` is `pinred`."""

import sys

from .cli.main import main

sys.exit(main())
