"""`python -m analysis.contest`: one thread, set before NumPy is imported."""

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

from analysis.contest.run import main

if __name__ == "__main__":
    main()
