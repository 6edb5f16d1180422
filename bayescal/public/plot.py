"""Figures of results, of the public API: `bc.plot`.

Each function takes a result (`fit`, `diagnose`) or what `load` reads from its run folder, and returns a
Matplotlib figure, which is not registered with pyplot: `figure.savefig("levels.pdf")`, or the last value of a
notebook's cell. Figures of a saved run are the same as those of the result.

`width_mm` is the width of the figure; its text keeps its size, and panels are below each other where there is
no room beside each other (80 mm is a column of a journal). With `ax` the first panel is drawn into axes of
the caller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.errors import BayescalError
from bayescal.posterior.inference import CHAINS, chains_figure
from bayescal.public import FitResult
from bayescal.reporting.figures.estimates import label, weakest
from bayescal.reporting.figures.figures import draw, drawn, posterior_content
from bayescal.reporting.fit.files import variable
from bayescal.storage.reading import read_json

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "arm", "budget", "distances", "levels", "parameters", "posterior", "residuals", "where", "which",
]  # fmt: skip
WIDTH = 160.0
"""Width of a figure, mm."""


def levels(result: Any, *, width_mm: float = WIDTH, ax: Axes | None = None) -> Figure:
    """Validation errors of the model levels, from nominal to the last.

    Parameters
    ----------
    result : FitResult or GapResult
    width_mm : float
        Width of the figure.
    ax : matplotlib.axes.Axes, optional
        Axes for the panel; their figure is returned.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=80, later=8, repeats=5, spheres=2, placements=1, seed=1)
    >>> figure = bc.plot.levels(bc.fit(session, samples=0), width_mm=80)
    >>> round(25.4 * figure.get_figwidth())
    80
    """
    return _drawn("levels", result, width_mm, ax)


def distances(result: Any, *, width_mm: float = WIDTH, ax: Axes | None = None) -> Figure:
    """Validation errors before and after.

    Of a calibration each certified distance with its 95 % prediction interval, and validation contacts and
    points; of a diagnosis the errors without and with the named effects. Parameters are those of `levels`.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=80, later=8, repeats=5, spheres=2, placements=1, seed=1)
    >>> figure = bc.plot.distances(bc.fit(session, samples=0))
    >>> bool(figure.axes[0].get_xlim()[0] < 0)
    True
    """
    return _drawn("distances", result, width_mm, ax)


def residuals(result: Any, *, width_mm: float = WIDTH, ax: Axes | None = None) -> Figure:
    """Errors of the rows over time, their distribution with the noise, and by target.

    A row is one mark: a residual with its sign, of a point the length of its error vector. Of a diagnosis,
    before and after the refit. Parameters are those of `levels`.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=80, later=8, repeats=5, spheres=0, seed=1)
    >>> len(bc.plot.residuals(bc.fit(session, samples=0)).axes)
    3
    """
    return _drawn("residuals", result, width_mm, ax)


def parameters(result: Any, *, width_mm: float = WIDTH, ax: Axes | None = None) -> Figure:
    """Estimates of the parameters of the arm against their priors, with 95 % intervals, of a calibration.

    Parameters are those of `levels`.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=80, later=8, repeats=5, spheres=0, seed=1)
    >>> figure = bc.plot.parameters(bc.fit(session, samples=0))
    """
    return _drawn("parameters", result, width_mm, ax)


def where(result: Any, *, width_mm: float = WIDTH, ax: Axes | None = None) -> Figure:
    """Locations of the error that a diagnosis found, the arm with its contacts, and fitted functions.

    A site is marked on the arm only if it is significant. Parameters are those of `levels`.

    Examples
    --------
    >>> import bayescal as bc
    >>> figure = bc.plot.where(bc.load("runs/session-gap"))  # doctest: +SKIP
    """
    return _drawn("where", result, width_mm, ax)


def which(result: Any, *, width_mm: float = WIDTH, ax: Axes | None = None) -> Figure:
    """Probabilities of effects and of sets of effects, of a diagnosis. Parameters are those of `levels`.

    Examples
    --------
    >>> import bayescal as bc
    >>> figure = bc.plot.which(bc.load("runs/session-gap"))  # doctest: +SKIP
    """
    return _drawn("which", result, width_mm, ax)


def arm(result: Any, *, width_mm: float = WIDTH, ax: Axes | None = None) -> Figure:
    """The nominal arm in a pose of the session, with the contacts and their errors.

    Signs point up for positive and down for negative residuals; their area is the size. Parameters are those
    of `levels`.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=80, later=8, repeats=5, spheres=0, seed=1)
    >>> figure = bc.plot.arm(bc.fit(session, samples=0), width_mm=80)
    """
    return _drawn("arm", result, width_mm, ax)


def budget(result: Any, *, width_mm: float = WIDTH, ax: Axes | None = None) -> Figure:
    """Components of an uncertainty budget by their contribution, type A and B.

    Parameters
    ----------
    result : FitResult or mapping
        A result that was read, of a run folder with budget.json, or the content of such a file.
    width_mm, ax
        As for `levels`.

    Examples
    --------
    >>> import bayescal as bc
    >>> figure = bc.plot.budget(bc.load("runs/session-fit"))  # doctest: +SKIP
    """
    return _drawn("budget", result if isinstance(result, Mapping) else _budget(result), width_mm, ax)


def posterior(
    result: FitResult, names: Sequence[str] = (), *, kind: str = "density", width_mm: float = WIDTH,
    ax: Axes | None = None,
) -> Figure:  # fmt: skip
    """Posterior distributions of parameters with their priors, and pairs of correlated parameters.

    Parameters
    ----------
    result : FitResult
    names : sequence of str
        Parameters; without names the six about which the data say least.
    kind : str
        "density", or a plot of ArviZ: "trace", "rank", "pair", "autocorrelation".
    width_mm, ax
        As for `levels`; plots of ArviZ have their own size.

    Raises
    ------
    BayescalError
        If the result is not a calibration, has no such parameter, or there is no such plot.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=80, later=8, repeats=5, spheres=0, seed=1)
    >>> figure = bc.plot.posterior(bc.fit(session, samples=0), ["a2", "d4"])
    >>> [axes.get_xlabel() for axes in figure.axes[:2]]
    ['a2 (mm)', 'd4 (mm)']
    """
    if not isinstance(result, FitResult):
        raise BayescalError("the figure `posterior` is of a calibration", "bc.plot", "give a calibration")
    entries = {p["name"]: p for p in result.record["parameters"]}
    for what, given, possible in (("parameter", names, entries), ("plot", [kind], ("density", *CHAINS))):
        for name in given:
            if name not in possible:
                remedy = f"give one of {', '.join(possible)}"
                raise BayescalError(f"there is no {what} `{name}`", "bc.plot.posterior", remedy)
    if kind == "density":
        return drawn(posterior_content(result.record, result.draws(list(entries)), names), width_mm, ax)

    shown = list(names) or weakest(dict(result.record))
    return chains_figure(result.inference_data(), kind, {variable(n): label(entries[n]) for n in shown})


def _budget(result: Any) -> Mapping[str, Any]:
    folder = getattr(result, "folder", None)
    if folder is None or not (path := Path(folder) / "budget.json").is_file():
        remedy = "save the result and load it, or give the content of a budget.json"
        raise BayescalError("there is no budget.json", str(folder or "bc.plot.budget"), remedy)
    content: Mapping[str, Any] = read_json(path, "repeat the command")
    return content


def _drawn(name: str, result: Any, width_mm: float, ax: Axes | None) -> Figure:
    record = result if isinstance(result, Mapping) else getattr(result, "record", None)
    if record is None:
        what = f"{type(result).__name__} is no result"
        raise BayescalError(what, f"bc.plot.{name}", "give what fit, diagnose or load returns")
    return draw(name, record, width_mm, ax)
