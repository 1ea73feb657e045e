"""`python -m calibration` is `jaxmpm calibrate`."""

import sys

from jaxmpm.cli import main

sys.exit(main(["calibrate", *sys.argv[1:]]))
