"""The fault campaign: `cd tests && python -m faults`, or `make faults`; see docs/faults.md."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

TESTS = Path(__file__).parents[1]

if __name__ == "__main__":
    # Before Numba is imported: a cache of its own, and threads that a forked child can do without.
    with tempfile.TemporaryDirectory(prefix="lierb-faults-") as scratch:
        os.environ["NUMBA_CACHE_DIR"] = str(Path(scratch) / "numba")
        os.environ["NUMBA_NUM_THREADS"] = "1"
        os.environ["PYTHONPATH"] = os.pathsep.join((str(TESTS), str(TESTS.parent)))
        from faults.campaign import main

        sys.exit(main(Path(scratch)))
