"""Studies, benchmarks, notebooks and the judge of the diagnosis: what is not installed with the package.

One thread a process, set before NumPy is imported: studies share out sessions to processes.
"""

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
