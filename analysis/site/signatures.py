"""The signature of an effect: the change of contacts by one prior standard deviation of each parameter."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import bayescal as bc
from analysis.charts import tidy
from bayescal.effects import EFFECTS, Circumstances, Driver, Effect, Parameter, Setting, Site
from bayescal.model import Scene, with_parameters
from bayescal.reporting.style import ACCENT, FAINT, INK

MICRO = 1e6
MOST_BARS = 12


@cache
def scene() -> Scene:
    """The session of all pictures: an LR Mate 200iC on four faces of a cube, half of it with 2 kg more."""
    return Scene(bc.simulate(contacts=400, later=0, repeats=0, spheres=0, payload=2.0, seed=1).dataset)


@cache
def circumstances() -> Circumstances:
    """The circumstances of that session."""
    return scene().circumstances(scene().rows("calibrate"))


def setting_of(effect: Effect) -> Setting:
    """The usual setting; of an effect that has none in this session, the middle of those that it scans."""
    if not effect.missing(circumstances()):
        return None
    assert effect.scan is not None, f"{effect.name} has no parameters in the session of the pictures"
    values = effect.scan.values(circumstances())
    return float(values[len(values) // 2])


@dataclass(frozen=True)
class Signature:
    """Parameters of an effect (P), and the change of residuals (N, P), m, by one prior standard deviation.

    `rows` (N,) are the rows of the contacts.
    """

    parameters: tuple[Parameter, ...]
    change: np.ndarray
    rows: np.ndarray

    @property
    def rms(self) -> np.ndarray:
        """RMS over the contacts, (P,), m."""
        return np.sqrt(np.mean(self.change**2, axis=0))

    @property
    def leading(self) -> Parameter:
        """The parameter with the largest change."""
        return self.parameters[int(np.argmax(self.rms))]

    @property
    def varies(self) -> bool:
        """Whether the change depends on a coordinate: a constant error has no curve."""
        return bool(self.leading.driver.coordinate(self.leading.site, circumstances()).label)

    def of(self, site: Site, driver: Driver) -> np.ndarray:
        """Indices of the parameters at a site with a driver."""
        return np.array([k for k, p in enumerate(self.parameters) if (p.site, p.driver) == (site, driver)])


@cache
def signature(name: str) -> Signature:
    """The signature of an effect at the nominal arm."""
    effect = EFFECTS[name]
    parameters = tuple(effect.at(circumstances(), setting_of(effect)))
    model = with_parameters(scene(), (), parameters)
    still, parts, rows = np.zeros(len(parameters)), [], []
    for block in model.blocks:
        _, by_arm, _ = block.linearise(still, np.zeros(block.size))
        parts.append(by_arm * model.sd)
        rows.append(block.rows)
    return Signature(parameters, np.concatenate(parts), np.concatenate(rows))


def _curve(axes, s: Signature) -> None:
    """The error at the contacts along the coordinate of the leading site."""
    leading = s.leading
    own = s.of(leading.site, leading.driver)
    best = own[np.argsort(-s.rms[own])][:2]
    along = leading.driver.coordinate(leading.site, circumstances())
    x = along.values[s.rows]
    for k, colour in zip(best, (ACCENT, FAINT), strict=False):
        axes.plot(x, MICRO * s.change[:, k], ".", ms=3.5, color=colour, label=s.parameters[k].name)
    axes.set(xlabel=along.label, ylabel="error at the contact, µm")
    axes.set_title(f"{leading.site.text}, {leading.driver.text}", loc="left")
    axes.axhline(0, color=INK, lw=0.6)
    if len(best) > 1:
        axes.legend(frameon=False, loc="best", fontsize=8)


def _bars(axes, labels: list[str], sizes: np.ndarray, unit: str) -> None:
    shown = np.sort(np.argsort(-sizes)[:MOST_BARS])[::-1]
    axes.barh([labels[k] for k in shown], sizes[shown], color=ACCENT)
    axes.set(xlabel=unit)
    left = len(labels) - len(shown)
    axes.set_title(f"{len(shown)} largest of {len(labels)}" if left else "", loc="left")


def picture(name: str) -> bytes:
    """The figure of an effect, PNG."""
    s = signature(name)
    labels = [p.name.removeprefix(f"{name} ") for p in s.parameters]
    curve = bool(np.any(s.change)) and s.varies
    height = 3.4 if curve else 1.0 + 0.2 * min(len(labels), MOST_BARS)
    figure = Figure(figsize=(8.6, height), layout="constrained")
    FigureCanvasAgg(figure)
    if np.any(s.change):
        widths = (1.5, 1) if curve else (1,)
        panels = list(figure.subplots(1, len(widths), width_ratios=widths, squeeze=False)[0])
        if curve:
            _curve(panels[0], s)
        _bars(panels[-1], labels, MICRO * s.rms, "RMS at the contacts, µm")
    else:  # it moves no contact, but a certified value
        panels = [figure.subplots()]
        size = np.array([p.sd for p in s.parameters])
        _bars(panels[0], labels, MICRO * size, "change of the certified value, µm or µrad")
    for axes in panels:
        tidy(axes)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return out.getvalue()


def bare() -> Circumstances:
    """The circumstances of a session that records joint readings alone."""
    return replace(
        circumstances(), loads=None, velocity=None, command=None, speed=None, time=None, temperature=None,
        faces=(), certified_values=(), approach=np.full_like(circumstances().approach, np.nan),
    )  # fmt: skip
