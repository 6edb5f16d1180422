"""`python -m analysis.methods`: one thread, set before NumPy is imported."""

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

from analysis.methods.run import main

if __name__ == "__main__":
    main()
