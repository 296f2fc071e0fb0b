"""One BLAS thread, as the command sets it: small factorisations are ten times slower with more."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
