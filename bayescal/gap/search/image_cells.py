"""Cells of cameras: what images show that neither an arm nor a tool moves.

A distortion that the model of the lens lacks, a clock that runs otherwise or reads the image row by row, and
points of a board that are not where they should be. A lens that varies is a site of `makers.movers`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from bayescal.arm.motion import IMAGE, Term
from bayescal.effects import Circumstances, Parameter, View
from bayescal.effects.imaging import at_view, late_images
from bayescal.effects.location import BOARD, CAMERA, Driver
from bayescal.estimate.families import cosines
from bayescal.gap.search.makers import Cell, repeated, shifts
from bayescal.gap.search.quantities import arguments
from bayescal.gap.settings import CELLS


def of_images(c: Circumstances) -> Iterator[Cell]:
    """Displacements of corners by their place in the image; clocks that depend on it or on any quantity."""
    for v in c.views:
        site, place = at_view(v, CAMERA), _place(v)
        pixel = v.centre.by[:, [0, 1], [0, 1]]  # (N, 2) m/px
        each = [[np.ones(len(x)), *cosines(x, c.fitted, CELLS.image_waves)] for x in place.T]
        field = [x * y for x, y in itertools.product(*each)][1:]
        radius = np.sum(place**2, axis=1)
        moved = [
            tuple(
                Parameter("", "px", (Term(IMAGE, "uv"[k], pixel[:, k] * f),), CELLS.pixels)
                for f in field for k in range(2)
            ),
            tuple(
                Parameter("", "px", shifts(pixel * place * (radius**n / scale)[:, None]), CELLS.pixels)
                for n in range(1, 4) if (scale := float(np.max(radius ** (n + 0.5)))) > 0
            ),
        ]  # fmt: skip
        yield Cell(site, Driver("image"), tuple(filter(None, moved)))
        if c.velocity is not None and late_images(c, v):
            others = [a.functions for a in arguments(c)]
            for form, ways in (("in the image", [*place.T[..., None]]), ("and another", others)):
                clocks = (
                    tuple(Parameter("", "s", late_images(c, v, f), CELLS.late) for f in (1.0, *of.T))
                    for of in ways
                )
                yield Cell(site, Driver("clock", form=form), tuple(clocks))


def of_each_image(c: Circumstances) -> Iterator[Cell]:
    """Errors that are drawn anew for each image: shifts along its sides, and the time of its readings."""
    for v in c.views:
        site, images = at_view(v, CAMERA), repeated(c, c.readings)
        for k in range(2):
            moved = Parameter("", "px", shifts(v.centre.by[:, :, k]), CELLS.pixels)
            yield Cell(site, Driver("pose", form="uv"[k]), ((moved,),), clusters=images)
        if c.velocity is not None and (late := late_images(c, v)):
            clock = Parameter("", "s", late, CELLS.late)
            yield Cell(site, Driver("clock", form="anew"), ((clock,),), clusters=images)


def of_points(c: Circumstances) -> Iterator[Cell]:
    """Errors of a board that are drawn anew for each of its points: across its plane, and within it."""
    for v in c.views:
        for axis, form in ((2, "heights"), (0, "places"), (1, "places")):
            error = Parameter("", "m", shifts(v.shift[:, :, axis]), CELLS.point)
            yield Cell(at_view(v, BOARD), Driver("board", form=form), ((error,),), clusters=v.point)


def _place(v: View) -> np.ndarray:
    """Places of the corners in the image over the focal length, from its axis, (N, 2); 0 in other rows."""
    focal, centre = (e.by[:, [0, 1], [0, 1]] for e in (v.focal, v.centre))
    return np.divide(focal, centre, out=np.zeros_like(focal), where=centre != 0)


IMAGES = (of_points, of_images, of_each_image)
"""Functions that list the cells of cameras and boards, in the order of the cells."""
