"""Tests, one file per module, in folders as in the package.

Matrices of a few dozen rows are too small for several threads: where other work, such as the other worker, keeps the
processor busy, OpenBLAS waits for its threads, and some tests take thirty times as long. So one thread it is.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
