"""`python -m analysis.benchmarks`: everything on one core with one thread, set before NumPy is imported."""

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"
os.environ["NPROC"] = "1"  # XLA's pool of threads
os.environ["JAX_PLATFORMS"] = "cpu"
if hasattr(os, "sched_setaffinity"):  # inherited by every process that the benchmark starts
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

from analysis.benchmarks.run import main

main()
