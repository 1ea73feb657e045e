"""What the tests compile is shared between them, and not with anyone else."""

import os
import tempfile

_kept = tempfile.TemporaryDirectory(prefix="jaxmpm-tests-")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", _kept.name)  # before JAX is imported
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")
