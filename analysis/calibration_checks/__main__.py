"""`python -m analysis.calibration_checks`: one thread, set before NumPy is imported."""

from analysis.calibration_checks.run import main

if __name__ == "__main__":
    main()
