"""`python -m analysis.planning`: one thread a process, set before NumPy is imported."""

from analysis.planning.run import main

if __name__ == "__main__":  # worker processes import this module too
    main()
