"""Measurement kinds and certificates: residuals, their gradients, and their factors in a GTSAM graph.

A kind knows the geometry of one target. Its state x is the target's displacement from its nominal
place, in m and rad, with prior standard deviations `sd`; p are ball centres in F0, laid out
(..., 3, C). ``residual(x, p)`` is (..., rows, C), in m; ``linearise(x, p)`` adds the gradients by
p, (..., rows, 3, C), and by x, (..., rows, C, size). Leading axes broadcast: posterior draws. `orientation`
alone judges turns of the tool, (..., 3, 3, C), and its residuals are in rad.

Nothing here knows robots or files; only `graph` knows GTSAM.
"""
