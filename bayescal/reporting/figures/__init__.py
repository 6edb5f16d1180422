"""Figures of records: of the contents of fit.json, gap.json and budget.json.

`figures.py` lists them, and writes them as PNG. Matplotlib is imported when one is drawn.
"""
