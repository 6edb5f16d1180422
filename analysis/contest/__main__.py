"""`python -m analysis.contest`: one thread, set before NumPy is imported."""

from analysis.contest.run import main

if __name__ == "__main__":
    main()
