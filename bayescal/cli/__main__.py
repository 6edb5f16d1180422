"""`python -m bayescal.cli` is the console script."""

from bayescal.cli import main

main()
