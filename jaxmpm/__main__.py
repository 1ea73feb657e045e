"""`python -m jaxmpm` is `jaxmpm`."""

import sys

from jaxmpm.cli import main

sys.exit(main())
