"""Side-by-side measurements, each run as `python -m benchmarks.<name>`.

Matrices of a few dozen rows are too small for several threads: where other work keeps the processor busy, OpenBLAS then
waits for its threads, and one solve in ten takes thirty times as long. Unless told otherwise all runs take one thread.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
