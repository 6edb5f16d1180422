"""Boxes of all text of a figure: what overlaps, and what is outside the figure."""

from itertools import combinations

from matplotlib.figure import FigureBase
from matplotlib.legend import Legend

SLACK = 1.0
"""Overlap that is not counted, pixels: boxes of text contain white space."""


def texts(figure):
    """All text that is drawn: titles, labels, legends, numbers, and the tick labels in view."""
    found = [text for part in figure.findobj(FigureBase) for text in part.texts]
    found += [text for legend in figure.findobj(Legend) for text in (legend.get_title(), *legend.get_texts())]
    for axes in figure.axes:
        found += [axes.title, *axes.texts]
        if axes.axison:
            for axis in (axes.xaxis, axes.yaxis):
                found += [axis.label, *(tick.label1 for tick in axis._update_ticks())]
    return [text for text in found if text.get_visible() and text.get_text().strip()]


def clashes(figure):
    """Pairs of texts that overlap, and texts that are not completely inside the figure."""
    figure.draw_without_rendering()
    renderer = figure._get_renderer()
    boxes = [(t.get_text(), t.get_window_extent(renderer)) for t in texts(figure)]
    width, height = figure.bbox.width, figure.bbox.height
    outside = [text for text, b in boxes if b.x0 < 0 or b.y0 < 0 or b.x1 > width + 0.5 or b.y1 > height + 0.5]
    over = [
        (one, two)
        for (one, a), (two, b) in combinations(boxes, 2)
        if min(a.x1, b.x1) - max(a.x0, b.x0) > SLACK and min(a.y1, b.y1) - max(a.y0, b.y0) > SLACK
    ]
    return over, outside
