"""Figures show the numbers of their record; no text overlaps or is cut off, at any width."""

import re
import shutil
import sys
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from boxes import clashes, texts
from cases import cases, refused, undrawn
from gap_diagnoses import bare, diagnosis, seven
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from scipy.stats import norm

import bayescal as bc
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated, estimate
from bayescal.model import build
from bayescal.model.scene import Scene
from bayescal.reporting import figures as process
from bayescal.reporting.figures import estimates, residuals, where
from bayescal.reporting.figures.estimates import BINS, weakest
from bayescal.reporting.figures.figures import CONTENT, FILES, FIT, GAP, draw, png
from bayescal.reporting.gap.record import gap_record
from bayescal.reporting.origin import rows_record
from bayescal.reporting.style import FAINT, INK, MARKED, NOISE, SERIES
from bayescal.reporting.text import level_labels

LONG = "the upper sphere of the artefact that stands behind the column of the machine $a_1$"
PLACE = "joint 2, angle of J2 times a function of another angle, 3 to 20 periods per revolution"


@pytest.fixture(scope="module")
def result():
    return bc.fit(bc.simulate(contacts=80, later=16, repeats=5, spheres=3, placements=1, seed=1), samples=0)


@pytest.fixture(scope="module")
def fit(result):
    return result.record


@pytest.fixture(scope="module")
def sessions(cube, tracker):
    """Records of diagnoses, by what is unusual about them."""
    own, points = cube(seed=1, count=80).dataset, tracker(seed=1, count=40).dataset
    more = seven(own)
    fits = {id(d): estimate(build(Scene(d), ("joint",)), robust=False) for d in (own, points, more)}
    rows = {key: rows_record(fitted) for key, fitted in fits.items()}

    def record(gap, dataset):
        return gap_record(gap) | {"rows": rows[id(dataset)]}

    out = {k: record(diagnosis(own, k), own) for k in ("null", "named", "unknown", "named+unexplained")}
    out["points"] = record(diagnosis(points, "named", distances=False), points)
    out["empty tables"] = record(bare(own), own)
    out["long names"] = lengthened(record(diagnosis(more, "named+unexplained"), more))
    return out


def lengthened(record):
    """The same, of seven joints, with the longest texts that occur: places, effects, targets, verdicts."""
    names = [f"{LONG} {k}" for k in range(20)]
    rows = record["rows"]
    rows = rows | {"target": [names[k % 20] for k in range(len(rows["id"]))]}
    effects = ["torque-dependent stiffness of a joint", "base-compliance", "second-harmonic", "gear-mesh"]
    sets = [{"effects": effects[: k + 1], "probability": 0.2, "log_evidence": 12345.6} for k in range(4)]
    last = record["ladder"][-1]
    step = last | {"model": [*last["model"], "eccentricity at joint 4 and joint 5"]}
    return record | {
        "words": [f"Ambiguous: these data do not distinguish {', '.join(names[:3])}"] * 2,
        "where": [w | {"text": PLACE, "explained_by": "second-harmonic"} for w in record["where"]] * 2,
        "curves": [c | {"text": PLACE} for c in record["curves"]],
        "hypotheses": sets,
        "missing": dict.fromkeys((f"an effect of my own {k}" for k in range(9)), "no time_s"),
        "ladder": [*record["ladder"], step],
        "rows": rows,
        "marked": names[0],
    }


def many_targets(fit):
    """A record of a fit with 20 targets of long names, and as long names of parameters."""
    names = [f"{LONG} {k}" for k in range(20)]
    rows = fit["rows"] | {"target": [names[k % 20] for k in range(len(fit["rows"]["id"]))]}
    checked = fit["validation"]
    distances = [d | {"between": names[:2]} for d in checked["distances"]] * 8
    planes = [p | {"target": LONG} for p in checked["planes"]]
    checked = checked | {"distances": distances, "planes": planes}
    own = [p | {"name": f"{p['name']} of {LONG}"} for p in fit["parameters"]]
    return fit | {"rows": rows, "validation": checked, "parameters": own}


CASES = {80: ("long names", "fit, many targets"), 160: ("long names",)}
"""Records by width: a wide figure has panels beside each other, and more room."""


@pytest.mark.parametrize("width", CASES)
def test_no_text_overlaps_or_is_cut_off(fit, sessions, width):
    every = sessions | {"fit, many targets": many_targets(fit)}
    records, faults = {case: every[case] for case in CASES[width]}, []
    for case, record in records.items():
        for name, of in CONTENT.items():
            measured = name not in ("distances", "levels") or estimates.levelled(record)
            if record["schema"] in of and measured:
                over, outside = clashes(draw(name, record, width))
                faults += [(case, name, pair) for pair in over] + [(case, name, text) for text in outside]
    assert faults == []


def test_values_of_many_digits_are_not_cut_off_in_a_posterior(result):
    """The tick label at the left edge of a narrow figure was outside of it."""
    figure = bc.plot.posterior(result, ["a2", "ball z", "compliance J5"], width_mm=80)
    for axes in figure.axes:
        low, high = axes.get_xlim()
        axes.set_xticks([low, high], ["−300.025", "−300.075"])
    assert clashes(figure) == ([], [])


def test_the_check_of_overlap_sees_an_overlap_and_a_cut_title():
    figure = Figure(figsize=(3, 2), dpi=220)
    figure.text(0.3, 0.5, "one label")
    figure.text(0.32, 0.5, "another")
    figure.text(0.8, 0.9, "a title that is too long for this")
    over, outside = clashes(figure)
    assert over == [("one label", "another")]
    assert outside == ["a title that is too long for this"]


def panel(name, record):
    """The axes of the first panel of a figure, drawn without the rest of its sheet."""
    return draw(name, record, ax=Figure().subplots()).axes[0]


def marks(axes, style):
    """Positions (K, 2) of marks in axes, of a style of a figure."""
    colour = to_hex(style.get("color", style.get("markeredgecolor", "k")))
    lines = [
        line for line in axes.lines
        if line.get_marker() == style["marker"] and to_hex(line.get_markeredgecolor()) == colour
    ]  # fmt: skip
    return np.concatenate([line.get_xydata() for line in lines]) if lines else np.zeros((0, 2))


def test_levels_are_those_of_the_record(fit, sessions):
    for record, key in ((fit, "heldout_planes_rms_um"), (sessions["named"], "heldout_rms_um")):
        drawn = marks(panel("levels", record), {"color": SERIES[0], "marker": "o"})
        assert drawn[:, 0] == pytest.approx([step[key] for step in record["ladder"]])
        assert np.all(np.diff(drawn[:, 1]) > 0)


def test_points_are_not_drawn_per_coordinate(sessions):
    """The error of a point is the length of its vector, in the levels too."""
    record = sessions["points"]
    levels = [step | {"point_length_rms_um": 3.0 * k + 1} for k, step in enumerate(record["ladder"])]
    record = record | {"lengths": record["lengths"] | {"of": "validation points"}, "ladder": levels}
    axes = panel("levels", record)
    assert len(marks(axes, {"color": SERIES[0], "marker": "o"})) == 0
    lengths = [3.0 * k + 1 for k in range(len(record["ladder"]))]
    assert marks(axes, {"color": SERIES[2], "marker": "D"})[:, 0] == pytest.approx(lengths)


def test_distances_are_those_of_the_record(fit):
    own = fit["validation"]["distances"]
    outside = [d | {"inside95": False} for d in own[:1]]
    record = fit | {"validation": fit["validation"] | {"distances": [*outside, *own[1:]]}}
    axes = panel("distances", record)
    inside = marks(axes, estimates.INSIDE)[:, 0]
    assert sorted(inside) == pytest.approx(sorted(d["calibrated_error_um"] for d in own[1:]))
    assert marks(axes, estimates.OUTSIDE)[:, 0] == pytest.approx([own[0]["calibrated_error_um"]])
    drawn = [c.get_segments() for c in axes.collections if to_hex(c.get_color()[0]) == FAINT]
    ends = {tuple(np.round([a[0], b[0]], 9)) for a, b in drawn[0]}
    assert ends == {tuple(np.round(d["predicted_interval95_um"], 9)) for d in own}


def test_a_reduction_is_that_of_the_record(sessions):
    record = sessions["named"]
    axes = panel("distances", record)
    own = list(record["lengths"]["shrinkage"].values())
    assert marks(axes, estimates.BEFORE)[:, 0] == pytest.approx([s["before_rms_um"] for s in own])
    assert marks(axes, estimates.AFTER)[:, 0] == pytest.approx([s["after_rms_um"] for s in own])


def test_each_row_of_a_fit_is_one_mark_at_its_residual(fit):
    rows = fit["rows"]
    axes = panel("residuals", fit)
    drawn = np.concatenate([marks(axes, style) for style in residuals.KINDS.values()])
    minutes = (np.array(rows["time_s"]) - min(rows["time_s"])) / 60.0
    expected = [both for both in zip(minutes, rows["residual_um"], strict=True) if both[1] is not None]
    assert np.array(sorted(map(tuple, drawn))) == pytest.approx(np.array(sorted(expected)), abs=1e-6)
    assert axes.get_xlabel() == "time (min)"
    each = zip(rows["residual_um"], rows["role"], strict=True)
    validation = sorted(v for v, role in each if v is not None and role == "validate")
    assert sorted(marks(axes, residuals.KINDS["validation"])[:, 1]) == pytest.approx(validation)


def test_a_point_is_one_mark_not_three(tracker):
    """Coordinates of a row were drawn one after the other, at three places of the axis."""
    dataset = tracker(seed=1, count=40).dataset
    gap = diagnosis(dataset, distances=False)
    error = 1e-6 * np.random.default_rng(0).standard_normal(3 * len(gap.residuals[0]))
    error[:3] *= 100.0
    gap = replace(gap, residuals=(np.repeat(gap.residuals[0], 3), error, 0.5 * error))
    record = gap_record(gap) | {"rows": rows_record(calibrated(Scene(dataset), ("geometry",)))}
    e = residuals.of_gap(record, "before")
    assert not e.signed
    lengths = np.linalg.norm(1e6 * error.reshape(-1, 3), axis=1)
    assert sorted(e.value) == pytest.approx(sorted(lengths), abs=1e-3)
    axes = panel("residuals", record)
    inside = np.sum(e.value <= residuals.edge_of(e, residuals.of_gap(record, "after")))
    assert len(marks(axes, residuals.KINDS["fitted"])) == inside
    assert axes.get_ylim()[0] == 0.0
    # what a fit excludes does not count in its RMS
    first, size = gap.residuals[0][:1], np.sqrt(np.mean(lengths[1:] ** 2))
    marked = record | {"residuals": gap_record(replace(gap, excluded=(first, first[:0])))["residuals"]}
    assert residuals.rms_of(residuals.of_gap(marked, "before")) == f"RMS error length {size:.1f} µm"
    assert not np.any(residuals.of_gap(marked, "after").kind == "rejected")


@pytest.mark.parametrize("components", [1, 2, 3])
def test_the_density_of_noise_is_that_of_draws(components):
    rng, edges = np.random.default_rng(0), np.linspace(-6, 6, 61)
    drawn = 1.5 * rng.standard_normal((components, 400_000))
    drawn = drawn[0] if components == 1 else np.linalg.norm(drawn, axis=0)
    heights, _ = np.histogram(drawn, edges, density=True)
    share = np.mean((drawn >= -6) & (drawn < 6))
    middle = 0.5 * (edges[1:] + edges[:-1])
    density = residuals.noise_density(middle, 1.5, components)
    used = middle > 0 if components > 1 else slice(None)
    assert heights[used] * share == pytest.approx(density[used], abs=5e-3)
    if components > 1:
        assert np.quantile(drawn / 1.5, 0.95) == pytest.approx(residuals.length95(components), abs=0.01)


def bars(axes):
    shown = [patch for patch in axes.patches if patch.get_width() < 1e6]
    return [(patch.get_width(), to_hex(patch.get_facecolor())) for patch in shown]


def test_bars_are_those_of_the_record(sessions):
    record = sessions["unknown"]
    drawn = bars(panel("where", record))
    shown = record["where"][: where.PLACES]
    assert [width for width, _ in drawn] == pytest.approx([w["rms_um"] for w in shown])
    expected = [where.significant(w["family_p_value"]) for w in shown]
    assert [colour != "#ffffff" for _, colour in drawn] == expected
    drawn = bars(panel("which", record))
    ranked = sorted(record["probability"].values(), reverse=True)
    assert [width for width, _ in drawn] == pytest.approx(ranked[: len(drawn)])


def test_sets_of_many_effects_are_stated_by_their_differences():
    sets = [["a", "b", "c", "d"], ["a", "b", "c"], ["a", "b", "c", "e"], []]
    assert where.set_labels(sets)[:3] == ["the 4 most probable", "without d", "with e, without d"]
    assert where.set_labels([["a", "b"], []]) == ["a + b", "noise only"]


def test_nothing_is_red_where_nothing_is_significant(sessions):
    """A joint was marked although no location was significant."""
    unknown = sessions["unknown"]
    unclear = [w | {"family_p_value": 0.3, "p_value": 0.1} for w in unknown["where"]]
    for record in (sessions["null"], unknown | {"where": unclear, "marked": None}):
        every = draw("where", record).axes
        assert to_hex(MARKED) not in {to_hex(line.get_color()) for axes in every for line in axes.lines}
        assert to_hex(MARKED) not in {to_hex(p.get_facecolor()) for axes in every for p in axes.patches}


@pytest.mark.parametrize(
    "site", ["joint 3", "link 2", "base", "tool", "probe", "arm", "artefact", "cube.+y", "none"]
)
def test_a_significant_site_is_marked_and_named(sessions, site):
    axes = panel("arm", sessions["named"] | {"marked": site})
    lines = {to_hex(c) for line in axes.lines for c in (line.get_color(), line.get_markerfacecolor())}
    rings = {to_hex(c) for own in axes.collections for c in own.get_edgecolors()}
    bodies = {to_hex(patch.get_facecolor()) for patch in axes.patches}
    assert to_hex(MARKED) in lines | rings | bodies
    assert site in [t.get_text() for t in texts(axes.figure)]


def test_the_site_of_every_named_effect_is_marked(sessions):
    """The figure marked the first alone, its page all."""
    amplitudes = [{"site": f"joint {k}", "significant": k < 6} for k in (4, 5, 6)]
    record = sessions["named"] | {"amplitudes": [*amplitudes, {"site": "arm", "significant": True}]}
    figure = draw("arm", record)
    assert "joint 4, joint 5, arm" in [t.get_text() for t in texts(figure)]
    rings = {to_hex(c) for own in figure.axes[0].collections for c in own.get_edgecolors()}
    assert to_hex(MARKED) not in rings  # about every contact, they hid the residuals
    assert sum(to_hex(line.get_color()) == to_hex(MARKED) for line in figure.axes[0].lines) == 2


def test_a_diagnosis_without_a_refit_has_no_residuals_before_it(sessions):
    for kind in ("null", "unknown", "named"):
        shown = " ".join(t.get_text() for t in texts(draw("arm", sessions[kind])))
        assert ("before the refit" in shown) == (kind == "named")


def test_a_long_label_of_an_axis_has_room(result):
    """The second line of 'compliance J4 (µrad/(N m))' below a pair was outside of the figure."""
    assert clashes(bc.plot.posterior(result, ["compliance J4", "compliance J5", "ball x"])) == ([], [])


def test_the_log_evidence_of_a_set_is_that_of_the_page(sessions):
    """It was rounded to '-0 nats'."""
    sets = [{"effects": ["latency"], "probability": 0.5, "log_evidence": -0.46}]
    shown = [t.get_text() for t in texts(draw("which", sessions["null"] | {"hypotheses": sets}))]
    assert "0.50  (−0.5 nats)" in shown


def test_signs_point_up_for_positive_residuals(fit):
    error = (e := residuals.of_fit(fit)).value
    axes = panel("arm", fit)
    assert e.signed
    assert [len(c.get_offsets()) for c in axes.collections] == [np.sum(error >= 0), np.sum(error < 0)]


def test_the_displacement_is_the_least_squares_fit_of_its_bin():
    rng = np.random.default_rng(0)
    x = np.repeat([-1.0, 0.5, 2.0], 30)
    lever, truth = rng.uniform(0.1, 1.0, 90) * rng.choice([-1, 1], 90), np.repeat([30.0, -10.0, 4.0], 30)
    residual = lever * truth + 0.1 * rng.standard_normal(90)
    curve = {"x": x, "residual_um": residual, "fitted_um": lever * truth, "lever": lever}
    middle, measured, error, explained = where.binned(curve)
    assert middle == pytest.approx([-1.0, 0.5, 2.0])
    expected = [np.linalg.lstsq(lever[x == m, None], residual[x == m], rcond=None)[0][0] for m in middle]
    assert measured == pytest.approx(expected)
    assert explained == pytest.approx([30.0, -10.0, 4.0])
    assert np.all(np.abs(measured - explained) < 2 * error)


def test_parameters_are_scaled_by_their_priors(fit):
    p = fit["parameters"][0]
    low, high, at = estimates.scaled(p)
    assert at * p["prior_sd"] + p["prior_mean"] == pytest.approx(p["estimate"])
    assert low < at < high
    axes = draw("parameters", fit).axes
    drawn = np.concatenate([marks(a, style) for a in axes for _, style in estimates.STYLES.values()])
    own = [estimates.scaled(p)[2] for p in fit["parameters"] if p["effect"] != "target"]
    assert sorted(drawn[:, 0]) == pytest.approx(sorted(own))


def segments(axes, colour):
    """Ends (K, 2) and heights (K,) of horizontal lines of a colour in several axes."""
    drawn = [c for a in axes for c in a.collections if to_hex(c.get_color()[0]) == to_hex(colour)]
    found = np.concatenate([s for c in drawn if len(s := c.get_segments())])
    return np.sort(found[:, :, 0], axis=1), found[:, 0, 1]


def test_a_fit_of_no_parameter_has_no_figure_of_parameters(fit):
    nominal = fit | {"parameters": [p for p in fit["parameters"] if p["effect"] == "target"]}
    assert set(undrawn(fit)) - set(undrawn(nominal, {"x": np.zeros((1, 9))})) == {"fit-parameters.png"}
    refused("no parameter of the arm", lambda: draw("parameters", nominal))


def test_the_band_of_a_prior_is_two_of_its_standard_deviations(fit):
    """Beside each estimate, with its 95 % interval, in the same unit; so the legend says."""
    own = [p for p in fit["parameters"] if p["effect"] != "target"]
    axes = draw("parameters", fit).axes
    ends, heights = segments(axes, NOISE)
    np.testing.assert_allclose(ends, np.tile([-2.0, 2.0], (len(own), 1)))
    drawn = np.concatenate([marks(a, style) for a in axes for _, style in estimates.STYLES.values()])
    assert sorted(heights) == pytest.approx(sorted(drawn[:, 1]))
    colours = {style.get("color", style.get("markeredgecolor")) for _, style in estimates.STYLES.values()}
    intervals = np.concatenate(
        [segments(axes, c)[0] for c in colours if any(len(marks(a, {"color": c, "marker": m}))
         for a in axes for m in "osD")]
    )  # fmt: skip
    expected = [[(v - p["prior_mean"]) / p["prior_sd"] for v in p["interval95"]] for p in own]
    np.testing.assert_allclose(sorted(map(tuple, intervals)), sorted(map(tuple, expected)))
    assert any("± 2 standard deviations" in t.get_text() for t in texts(draw("parameters", fit)))


def test_a_posterior_and_its_prior_are_those_of_the_draws(result, tmp_path):
    name = weakest(result.record)[0]
    (p,) = (p for p in result.record["parameters"] if p["name"] == name)
    axes = bc.plot.posterior(result, [name]).axes[0]
    (prior,) = (line for line in axes.lines if line.get_linestyle() == "--")
    x, y = prior.get_data()
    np.testing.assert_allclose(y, norm.pdf(x, p["prior_mean"], p["prior_sd"]))
    # a posterior is that of the draws
    (polygon,) = axes.patches
    draws = result.inference_data().posterior[name.replace(" ", "_")].values.ravel()
    expected, at = np.histogram(draws, BINS, density=True)
    edges, heights = polygon.get_xy()[: 2 * BINS + 2].T  # of its upper side: two vertices at each edge
    assert edges == pytest.approx(np.repeat(at, 2))
    assert heights == pytest.approx([0.0, *np.repeat(expected, 2), 0.0], rel=1e-6)


def lightness(colour):
    """CIE L* of a colour."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    y = float(linear @ [0.2126, 0.7152, 0.0722])
    return 116 * np.cbrt(y) - 16 if y > 0.008856 else 903.3 * y


DEFICIENCIES = cases("deficiencies")
"""Machado, Oliveira, Fernandes (2009), severity 1, of linear RGB."""


def test_series_differ_in_grey_and_for_colour_blind_readers():
    assert np.all(np.diff([lightness(c) for c in SERIES]) > 12)
    assert lightness(MARKED) - lightness(INK) > 15
    linear = np.array([to_rgb(c) for c in SERIES]) ** 2.2
    for matrix in DEFICIENCIES.values():
        seen = (linear @ np.array(matrix).T).clip(0, 1) ** (1 / 2.2)
        assert min([np.linalg.norm(a - b) for k, a in enumerate(seen) for b in seen[:k]]) > 0.15


def test_files_are_undated_and_settings_of_the_user_neither_matter_nor_change(fit):
    plain = png(draw("levels", fit, 80))
    assert not re.search(rb"\d{4}-\d\d-\d\dT|matplotlib|tEXt", plain)
    with mpl.rc_context({"font.size": 30, "axes.facecolor": "yellow", "text.usetex": False}):
        assert png(draw("levels", fit, 80)) == plain
        assert mpl.rcParams["font.size"] == 30


def test_names_are_not_read_as_formulas(fit):
    named = [text for text in texts(draw("residuals", many_targets(fit))) if "$" in text.get_text()]
    assert named
    assert not any(text.get_parse_math() for text in named)


def test_panels_are_drawn_into_axes_of_the_user(fit):
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2)
    assert bc.plot.levels(fit, ax=left) is figure
    assert left.get_xlabel() == "error (µm)"
    assert not right.lines
    pyplot.close(figure)


@pytest.fixture(scope="module")
def kept(result, tmp_path_factory):
    """The folder of a run with its pictures, drawn by a second process, and the names of its files."""
    folder = tmp_path_factory.mktemp("kept") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(process, "cores", lambda: 2)
        patch.setattr(process, "figures_of", lambda *given: pytest.fail("drawn here"))
        patch.delitem(sys.modules, "matplotlib")
        with process.drawing_beside():
            return folder, result.save(folder)


def test_a_saved_run_draws_the_same_pictures(result, kept, tmp_path):
    folder, names = kept
    shutil.copytree(folder, tmp_path / "run")
    expected = {*FILES[FIT], "fit-posterior.png"}
    assert expected <= set(names)
    assert {path.name for path in (tmp_path / "run").glob("*.png")} == expected
    saved = bc.load(tmp_path / "run")
    assert png(bc.plot.levels(saved)) == (tmp_path / "run" / "fit-levels.png").read_bytes()
    assert png(bc.plot.posterior(saved)) == (tmp_path / "run" / "fit-posterior.png").read_bytes()
    result.save(tmp_path / "run", pictures=False)
    assert not list((tmp_path / "run").glob("*.png"))


@pytest.mark.parametrize("kind", ["trace", "rank", "pair", "autocorrelation"])
def test_plots_of_arviz_have_units(result, kind):
    figure = bc.plot.posterior(result, ["a2", "d4"], kind=kind)
    words = " ".join(t.get_text() for t in figure.findobj(mpl.text.Text))
    assert "a2 (mm)" in words
    assert "d4 (mm)" in words


def test_what_cannot_be_drawn_is_said_in_one_line(result, sessions):
    old = {k: v for k, v in sessions["named"].items() if k != "rows"}
    for plot, given, options, words in (
        (bc.plot.where, result, {}, "`where` is of a diagnosis, not of a calibration"),
        (bc.plot.posterior, result, {"names": ["a99"]}, "there is no parameter `a99`"),
        (bc.plot.posterior, result, {"kind": "violin"}, "there is no plot `violin`"),
        (bc.plot.posterior, sessions["named"], {}, "`posterior` is of a calibration"),
        (bc.plot.levels, 3, {}, "int is no result"),
        (bc.plot.budget, result, {}, r"there is no budget\.json"),
        (bc.plot.arm, old, {}, "the record has no `rows`"),
        (bc.plot.distances, sessions["empty tables"], {}, "there are no validation measurements"),
        (bc.plot.levels, sessions["empty tables"], {}, "there are no validation measurements"),
    ):
        with pytest.raises(BayescalError, match=words):
            plot(given, **options)


def test_a_budget_shows_its_components_the_largest_first():
    components = [{"name": f"c{k}", "type": "AB"[k % 2], "contribution_um": float(k + 1)} for k in range(15)]
    u = float(np.sqrt(sum(c["contribution_um"] ** 2 for c in components)))
    sums = {"u_um": u, "U_um": 2 * u, "k": 2.0}
    record = {"schema": "bayescal-budget/1", "measurand": "a distance", "components": components} | sums
    figure = bc.plot.budget(record, width_mm=80)
    assert [width for width, _ in bars(figure.axes[0])] == pytest.approx(list(range(15, 3, -1)))
    assert clashes(figure) == ([], [])


def test_every_file_of_a_run_is_a_figure():
    for schema, files in FILES.items():
        assert all(schema in CONTENT[name] for name in files.values())
    assert set(FILES[GAP]) == {"gap-where.png", "gap-which.png", "gap-levels.png", "gap-residuals.png"}
    assert set(bc.plot.__all__) == {*CONTENT, "posterior"}
    assert level_labels([{"model": ["nominal"]}]) == ["nominal"]


def test_distances_that_are_shown_have_the_largest_errors_of_either_sign():
    def distance(k):
        error = (-1) ** k * (10.0 + k)
        return {
            "between": ["a", f"t{k}."], "certified_mm": 100.0, "nominal_error_um": 0.0, "inside95": True,
            "calibrated_error_um": error, "predicted_interval95_um": [-20.0, 20.0],
        }  # fmt: skip

    axes = Figure().subplots()
    distances = [distance(k) for k in range(estimates.MOST + 8)]
    estimates.distances_panel({"validation": {"distances": distances}}).draw(axes)
    said = " ".join(text.get_text() for text in axes.texts)
    assert [k for k in range(estimates.MOST + 8) if f"t{k}." in said] == list(range(8, estimates.MOST + 8))
