"""`python -m analysis.planning`: one thread a process, set before NumPy is imported."""

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

from analysis.planning.run import main

if __name__ == "__main__":  # worker processes import this module too
    main()
