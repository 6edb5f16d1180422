"""`python -m analysis.study`: one thread a process, set before NumPy is imported."""

from analysis.study.run import main

if __name__ == "__main__":  # worker processes import this module too
    main()
