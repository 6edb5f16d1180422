"""``python -m analysis.compensation --seed 7 --count 60 --out docs/compensation_study.md``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from analysis.compensation.page import write
from analysis.compensation.session import session


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=7, help="of the simulated sessions")
    parser.add_argument("--count", type=int, default=60, help="numbers of sessions, from 0")
    parser.add_argument("--out", type=Path, default=Path("docs/compensation_study.md"))
    asked = parser.parse_args()
    found = []
    for number in range(asked.count):
        if (one := session(asked.seed, number)) is not None:
            found.append(one)
            write(found, asked.seed, number + 1, asked.out)
            sys.stderr.write(f"{number}: {', '.join(one.hidden) or 'no effect'}\n")


if __name__ == "__main__":
    main()
