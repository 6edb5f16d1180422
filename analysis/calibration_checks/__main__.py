"""`python -m analysis.calibration_checks`: one thread, set before NumPy is imported."""

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

from analysis.calibration_checks.run import main

if __name__ == "__main__":
    main()
