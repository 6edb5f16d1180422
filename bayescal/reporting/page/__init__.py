"""Pages of results: one self-contained HTML file for a run, several runs or a plan.

A page is a list of sections, and a section is a function of a run's records (`section.Section`). A further
section is one function and one line in `fit.SECTIONS` or `gap.SECTIONS`.
"""
