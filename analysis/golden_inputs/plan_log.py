"""Write the log of a probing program that measured a plan: ``python plan_log.py PLAN LOG``; seeded."""

import csv
import sys

import numpy as np

plan, log = sys.argv[1:]
rng = np.random.default_rng(11)
with open(f"{plan}/plan.csv", newline="", encoding="utf-8") as file:
    rows = list(csv.DictReader(file))
with open(log, "w", encoding="utf-8") as out:
    for number, row in enumerate(rows):
        readings = [float(row[f"j{j + 1}_deg"]) + rng.normal(0, 0.01) for j in range(6)]
        state = 2 if number == 3 else 1  # one contact was not found
        out.write(f"bayescal, {row['id']}, deg, [{state}, {', '.join(f'{q:.6f}' for q in readings)}]\n")
