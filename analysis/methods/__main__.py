"""`python -m analysis.methods`: one thread, set before NumPy is imported."""

from analysis.methods.run import main

if __name__ == "__main__":
    main()
