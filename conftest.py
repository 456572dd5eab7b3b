"""One thread a library, set before any of them is imported: tests time and compare, and machines are small."""

from __future__ import annotations

import os
import signal

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")

# a test run started in the background inherits an ignored SIGINT, and so would the commands under test
signal.signal(signal.SIGINT, signal.default_int_handler)
