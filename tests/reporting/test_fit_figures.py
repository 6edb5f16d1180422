"""Every figure of fit.json, by a walk over it: from the dataset, robot.yaml and posterior.nc alone.

The arm is the chain of the robot file that the run wrote (or of the nominal one), targets are fitted anew to
its points, and what is stated of the posterior is that of the draws. No number is without a rule.
"""

import html
import io
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cases import cases
from rich.console import Console
from scipy.optimize import least_squares
from sessions import validating, with_columns

import bayescal as bc
from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.posterior.inference import arviz, load
from bayescal.robots import load_robot

UM, DEG = 1e6, 180.0 / np.pi
az = arviz()
OUTLIER = 20
ELSEWHERE = cases("fit_figures_elsewhere")
"""What follows from no formula of a few lines, and where it is tested."""


class Some(list):
    """The first entries of a list."""


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def located(p, target, ball, noise):
    """Centre and diameter of a sphere by contacts (C, 3): both have their priors of 50 mm and 1 mm."""
    stated = np.append(target.values["centre"], target.values["diameter"])

    def residual(x):
        off = np.linalg.norm(p - x[:3], axis=1) - (0.5 * x[3] + ball)
        return np.concatenate([off / noise, (x - stated) / [0.05, 0.05, 0.05, 1e-3]])

    return least_squares(residual, stated, xtol=1e-15, ftol=1e-15, gtol=1e-15).x


def level(dataset, robot, tip, rejected):
    """Of one arm: points, m; residuals of rows (vectors of instruments), distances and diameters, µm."""
    m = dataset.measurements
    angles = link_angles(robot, m.readings)
    flange = frames(chain_of(robot), angles)[:, -1]
    p, spheres, off = flange[:, :3, :3] @ tip + flange[:, :3, 3], {}, np.full((len(m.ids), 3), np.nan)
    for k, target in enumerate(dataset.targets):
        own = m.target == k
        fitted = own & (m.role == "calibrate") & ~rejected
        if target.kind == "plane":
            middle = p[fitted].mean(axis=0)
            normal = np.linalg.svd(p[fitted] - middle)[2][2]
            normal *= np.sign(normal @ target.values["normal"])
            off[own] = np.column_stack([(p[own] - middle) @ normal, *np.zeros((2, own.sum()))])
        elif target.kind == "instrument":
            middle, read = p[fitted].mean(axis=0), m.xyz[fitted].mean(axis=0)
            u, _, v = np.linalg.svd((m.xyz[fitted] - read).T @ (p[fitted] - middle))
            turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
            off[own] = (p[own] - middle) @ turn.T + read - m.xyz[own]
    left = off[(m.role == "calibrate") & ~rejected & ~np.isnan(off[:, 0])]
    parts = len(left[0, left[0] != 0.0]), 3 * len(set(m.target[~np.isnan(off[:, 0])]))
    noise = np.sqrt(np.sum(left**2) / (parts[0] * len(left) - parts[1]))
    for k, target in enumerate(dataset.targets):
        if target.kind == "sphere":
            spheres[target.name] = located(p[m.target == k], target, dataset.tools[0].ball_radius, noise)
    pairs = [c.targets for c in dataset.certificates if c.kind == "distance"]
    return SimpleNamespace(
        noise=UM * noise, points=p, angles=angles, off=UM * off, length=UM * np.linalg.norm(off, axis=1),
        distance={(a, b): UM * np.linalg.norm(spheres[a][:3] - spheres[b][:3]) for a, b in pairs},
        diameter={name: UM * x[3] for name, x in spheres.items()},
    )  # fmt: skip


def contacts(cube, tracker):
    few = {"contacts": 70, "later": 12, "repeats": 3, "spheres": 3, "placements": 1, "seed": 3}
    session = bc.simulate(effects="geometry", **few).dataset
    readings = session.measurements.readings.copy()
    readings[OUTLIER] += 5e-3
    lengths = tuple(c for c in session.certificates if c.kind == "distance")
    return with_columns(replace(session, certificates=lengths), readings=readings)


def points(cube, tracker):
    return validating(tracker(seed=2, count=90).dataset, 4)


@pytest.fixture(scope="module", params=[contacts, points], ids=["contacts", "points"])
def run(request, cube, tracker, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "fit"
    dataset = request.param(cube, tracker)
    result = bc.fit(dataset, "geometry", samples=400)
    result.save(folder, pictures=False)
    record = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    estimate = {p["name"]: p["estimate"] for p in record["parameters"]}
    tool = dataset.tools[0]
    tip = 1e-3 * np.array([estimate[f"{tool.name} {axis}"] for axis in "xyz"])
    rejected = np.isin(dataset.measurements.ids, record["rejected"])
    return SimpleNamespace(
        folder=folder, result=result, record=record, dataset=dataset, nc=load(folder / "posterior.nc"),
        rejected=rejected,
        nominal=level(dataset, dataset.robot, tool.centre, rejected),
        calibrated=level(dataset, load_robot("robot.yaml", folder)[0], tip, rejected),
    )  # fmt: skip


def rows_of(run, name, role, kept=True):
    m = run.dataset.measurements
    names = np.array([t.name for t in run.dataset.targets])[m.target]
    return (names == name) & (m.role == role) & ~(run.rejected & kept)


def of_parameters(run):
    """From the draws of the file, in the units that it states."""
    robot, posterior = run.dataset.robot, run.nc["posterior"]
    rows = {"a": 1e3 * robot.a, "d": 1e3 * robot.d, "alpha": DEG * robot.alpha, "theta": DEG * robot.offset,
            "beta": DEG * robot.beta}  # fmt: skip
    prior = {p["name"]: p for p in run.record["parameters"]}
    for name in prior:
        drawn = posterior[name.replace(" ", "_")]
        flat, found = np.asarray(drawn).ravel(), re.fullmatch(r"([a-z]+)(\d)", name)
        nominal = rows[found[1]][int(found[2]) - (found[1] in ("d", "theta"))] if found else 0.0
        if prior[name]["effect"] == "tool":
            nominal = 1e3 * run.dataset.tools[0].centre["xyz".index(name[-1])]
        z = np.asarray(run.nc["posterior"]["z"].sel(parameter=name.replace(" ", "_"))).ravel()
        ways = ({"method": "bulk"}, {"method": "tail", "prob": (0.05, 0.95)})
        ess = [pytest.approx(float(np.asarray(az.ess(np.asarray(drawn), **way))), rel=0.02) for way in ways]
        rhat = float(np.asarray(az.rhat(np.asarray(drawn))))
        widened = prior[name]["sd"] > 1.001 * prior[name]["sd_without_discrepancy"]
        figures = {"unit": drawn.attrs["units"], "nominal": nominal, "prior_mean": nominal, "sd": flat.std()}
        figures |= {
            "estimate": pytest.approx(flat.mean(), abs=0.5 * flat.std()),
            "prior_sd": flat.std() / z.std(),
        }
        figures |= {"contraction": 1.0 - z.var(), "interval95": list(np.quantile(flat, [0.025, 0.975]))}
        if not widened:
            least = min(ess, key=lambda e: e.expected)
            figures |= {"ess_bulk": ess[0], "ess_tail": ess[1], "ess": least, "rhat": rhat}
        yield name, figures


def of_planes(run):
    drawn, shown = run.nc["posterior_predictive"], []
    for name in dict.fromkeys(r["target"] for r in run.record["residuals"]):
        own, ids = rows_of(run, name, "validate"), np.array(run.dataset.measurements.ids)
        off, after = run.calibrated.off[own, 0], run.calibrated.length[own]
        predicted = np.asarray(drawn["heldout_um"].sel(heldout=ids[own])).reshape(-1, own.sum())
        low, high = np.quantile(predicted, [0.025, 0.975], axis=0)
        shown.append({
            "target": name,
            "role": "validate",
            "count": own.sum(),
            "nominal_rms_um": pytest.approx(rms(run.nominal.length[own]), rel=0.06),
            "calibrated_rms_um": rms(after),
            "calibrated_max_um": max(after),
            "predicted_rms_um": pytest.approx(rms(predicted), rel=0.1),
            "inside95_fraction": np.mean((low <= off) & (off <= high)),
        })  # fmt: skip
    return shown


def of_draws(run, places):
    """Of the arms of some draws, by their places in all of them."""
    drawn = run.nc["posterior"].stack(draws=("chain", "draw")).isel(draws=places)
    for k in range(len(places)):
        value = {name: float(drawn[name][k]) for name in drawn.data_vars if name != "z"}
        robot, fields = run.dataset.robot, ("a", "d", "alpha", "offset", "beta")
        rows = {field: getattr(robot, field).copy() for field in fields}
        for field, column in rows.items():
            name, unit = field.replace("offset", "theta"), 1e-3 if field in "ad" else 1 / DEG
            numbers = [f"{name}{row + (name in ('d', 'theta'))}" for row in range(len(column))]
            column[:] = [unit * value.get(n, x / unit) for n, x in zip(numbers, column, strict=True)]
        tip = 1e-3 * np.array([value[f"{run.dataset.tools[0].name}_{axis}"] for axis in "xyz"])
        yield level(run.dataset, replace(robot, **rows), tip, run.rejected)


def of_distances(run):
    count = run.nc["posterior"].sizes["chain"] * run.nc["posterior"].sizes["draw"]
    places = np.linspace(0, count - 1, 500).astype(int)[::50]
    arms = list(of_draws(run, places)) if run.calibrated.distance else []
    for (a, b), length in run.calibrated.distance.items():
        value = next(c.distance for c in run.dataset.certificates if c.targets == (a, b))
        drawn = np.asarray(run.nc["posterior_predictive"]["distance_mm"].sel(pair=f"{a}|{b}")).ravel()
        error = length - UM * value
        assert np.corrcoef(drawn[::50], [arm.distance[a, b] for arm in arms])[0, 1] > 0.9
        spread = error - 1e3 * (drawn - 1e3 * value)
        ends = np.quantile(spread, [0.025, 0.975])
        yield {
            "between": [a, b],
            "certified_mm": 1e3 * value,
            "nominal_error_um": pytest.approx(run.nominal.distance[a, b] - UM * value, rel=0.15, abs=30),
            "calibrated_error_um": error,
            "predicted_sd_um": pytest.approx(spread.std(), rel=0.15),
            "predicted_interval95_um": [pytest.approx(e, abs=0.3 * spread.std()) for e in ends],
            "inside95": bool(ends[0] <= error <= ends[1]),
        }


def of_diameters(run):
    for name, diameter in run.calibrated.diameter.items():
        certified = UM * next(t.values["diameter"] for t in run.dataset.targets if t.name == name)
        nominal = pytest.approx(run.nominal.diameter[name] - certified, rel=0.15)
        errors = {"nominal_error_um": nominal, "calibrated_error_um": diameter - certified}
        yield {"target": name, "certified_mm": 1e-3 * certified, **errors}


def of_points(run, own):
    """Lengths of the vectors of points; the draws are of their coordinates."""
    before, after, off = run.nominal.length[own], run.calibrated.length[own], run.calibrated.off[own]
    drawn = run.nc["posterior_predictive"]["point_um"].sel(point=np.array(run.dataset.measurements.ids)[own])
    drawn = np.asarray(drawn.transpose(..., "point", "axis")).reshape(-1, *off.shape)
    length, (low, high) = np.linalg.norm(drawn, axis=2), np.quantile(drawn, [0.025, 0.975], axis=0)
    return {
        "count": own.sum(),
        "nominal_mean_um": before.mean(),
        "nominal_max_um": before.max(),
        "calibrated_mean_um": after.mean(),
        "calibrated_rms_um": rms(after),
        "calibrated_max_um": after.max(),
        "predicted_mean_um": pytest.approx(length.mean(), rel=0.02),
        "predicted_mean_interval95_um": [
            pytest.approx(q, rel=0.05) for q in np.quantile(length.mean(axis=1), [0.025, 0.975])
        ],
        "predicted_upper95_um": pytest.approx(np.quantile(length, 0.95), rel=0.05),
        "inside95_fraction": pytest.approx(np.mean((low <= off) & (off <= high)), abs=0.05),
    }


def of_level(run, errors, name, validate, distances):
    planes, points = bool(run.calibrated.distance), not run.calibrated.distance
    loose = 0.15 if name == "nominal" else 1e-3  # robust weights of spheres that fit badly
    return {
        "model": [name],
        "noise_estimated_um": pytest.approx(errors.noise, rel=0.3),
        "heldout_planes_rms_um": pytest.approx(rms(errors.length[validate]), rel=loose) if planes else None,
        "points_rms_um": rms(errors.length[validate]) if points else None,
        "points_mean_um": errors.length[validate].mean() if points else None,
        "distance_rms_um": pytest.approx(rms(distances), rel=loose) if planes else None,
        "worst_distance_um": pytest.approx(max(np.abs(distances)), rel=loose) if planes else None,
    }  # fmt: skip


def of_rows(run):
    m, sign = run.dataset.measurements, np.array(["-", "0", "+"])
    if m.velocity is not None:
        moving = np.where(np.abs(DEG * m.velocity) < 0.03, 0, np.sign(m.velocity)).astype(int)
    vectors = run.dataset.targets[0].kind == "instrument"
    residual = run.calibrated.length if vectors else run.calibrated.off[:, 0]
    return {
        "id": list(m.ids),
        "target": [run.dataset.targets[k].name for k in m.target],
        "role": m.role.tolist(),
        "time_s": None if m.time is None else m.time,
        "point_mm": np.round(1e3 * run.nominal.points, 3),
        "angle_deg": np.round(DEG * run.nominal.angles, 4),
        "direction": None if m.velocity is None else ["".join(sign[row + 1]) for row in moving],
        "residual_um": [None if np.isnan(r) else pytest.approx(r, abs=6e-2) for r in residual],
        "rejected": run.rejected.tolist(),
    }


def expected(run):
    """What fit.json says, of all that follows from other files."""
    m, record = run.dataset.measurements, run.record
    validate = (m.role == "validate") & ~np.isnan(run.calibrated.length)
    planes = [] if not run.calibrated.distance else of_planes(run)
    distances = list(of_distances(run))
    pairs, certified = [tuple(d["between"]) for d in distances], [d["certified_mm"] for d in distances]
    lengths = (np.array([x.distance[p] for p in pairs]) for x in (run.nominal, run.calibrated))
    before, after = (length - 1e3 * np.array(certified) for length in lengths)
    group = "contact" if planes else "point"
    stated = UM * getattr(run.dataset.noise, group)
    scale = float(np.asarray(run.nc["posterior"]["noise_scale"]).mean())
    parameters = dict(of_parameters(run))
    arm = [p["name"] for p in record["parameters"] if p["effect"] != "target"]
    draws = np.array([np.asarray(run.nc["posterior"][n.replace(" ", "_")]).ravel() for n in arm])
    r = np.corrcoef(draws)
    pairs = [(i, j) for j in range(len(arm)) for i in range(j) if abs(r[i, j]) >= 0.3]
    pairs.sort(key=lambda pair: -abs(r[pair]))
    accuracy = [("AP n" if planes else "AP", run.calibrated.length[validate])]
    accuracy += [("AD", np.abs(after))] if planes else []
    lengths = [min(certified), max(certified)] if planes else None
    first = record["predicted_distance"]
    lead = {"coverage": 0.9545, "expanded_U_um": first["k"] * first["predicted_rms_um"]}
    if planes:
        lead |= {"lengths_mm": lengths, "measured_rms_um": rms(after), "count": len(after)}
    return {
        "seed": 0,
        "prior_width": 1.0,
        "model": ["geometry"],
        "parameters": [{"name": name, **parameters[name]} for name in parameters],
        "correlations": [{"a": arm[i], "b": arm[j], "r": pytest.approx(r[i, j], abs=6e-5)} for i, j in pairs],
        "noise": {
            "group": group,
            "stated_um": stated,
            "estimated_um": pytest.approx(stated * scale, rel=0.1),
            "scale": {group: pytest.approx(scale, rel=0.1)},
        },
        "residuals": [
            {
                "target": x["target"],
                "role": role,
                "count": rows_of(run, x["target"], role, False).sum(),
                "rejected": (rows_of(run, x["target"], role, False) & run.rejected).sum(),
                "rms_um": rms(own),
                "max_um": own.max(),
            }
            for x in record["residuals"][::2]
            for role in ("calibrate", "validate")
            for own in (run.calibrated.length[rows_of(run, x["target"], role)],)
        ],
        "rejected": [m.ids[OUTLIER]] if planes else [],
        "predicted_distance": lead | {"all": Some([lead])},
        "iso9283": {
            "figures": [
                {"symbol": s, "count": len(e), "mean_um": e.mean(), "max_um": e.max()} for s, e in accuracy
            ]
        },
        "validation": {
            "planes": planes,
            "distances": distances,
            "diameters": list(of_diameters(run)),
            "points": {"count": 0} if planes else of_points(run, validate),
            "orientations": {"count": 0},
            "worst_distance_um": {
                "nominal": pytest.approx(max(np.abs(before)), rel=0.15) if planes else None,
                "calibrated": max(np.abs(after)) if planes else None,
            },
        },
        "ladder": [
            of_level(run, run.nominal, "nominal", validate, before),
            {},
            of_level(run, run.calibrated, "geometry", validate, after),
        ],
        "rows": of_rows(run),
    }


def compared(found, wanted, path=""):
    """Differences between what is found and what is wanted, and numbers of which nothing is wanted."""
    if isinstance(found, dict):
        for key, value in found.items():
            own = wanted.get(key, ...) if isinstance(wanted, dict) else ...
            yield from compared(value, own, f"{path}.{key}" if path else key)
    elif isinstance(found, list) and wanted is not ...:
        if len(found) != len(wanted) and not isinstance(wanted, Some):
            yield f"{path}: {len(found)} entries, not {len(wanted)}"
        for k, value in enumerate(found):
            yield from compared(value, wanted[k] if k < len(wanted) else ..., f"{path}.{k}")
    elif isinstance(found, list):
        for value in found[:1]:
            yield from compared(value, ..., f"{path}.0")
    elif wanted is not ...:
        exact = isinstance(wanted, float | np.floating)
        if found != (
            pytest.approx(wanted, rel=1e-3, abs=0.02 if path.endswith("_um") else 1e-6) if exact else wanted
        ):
            yield f"{path}: {found}, not {wanted}"
    elif isinstance(found, float) and not any(re.fullmatch(known, path) for known in ELSEWHERE):
        yield f"{path}: {found}, without a rule"


def test_every_figure_of_fit_json(run):
    differ = "\n".join(compared(run.record, expected(run)))
    assert not differ, differ


ROLES = {"calibrate": "fitted", "validate": "validation"}
EXPECTED = ("predicted_rms_um", "expanded_U_um", "k", "predicted_interval95_um", "measured_rms_um")
LEVEL = ("heldout_planes_rms_um", "distance_rms_um", "worst_distance_um", "predicted_distance_interval95_um",
         "points_rms_um", "points_mean_um", "points_max_um")  # fmt: skip
DISTANCE = ("certified_mm", "nominal_error_um", "calibrated_error_um")
ACCURACY = ("count", "mean_um", "u_mean_um", "max_um", "u_max_um")
NUMBERS = ("nominal", ("estimate", "sd"), None, "prior_sd", None, None)
SHEETS = {
    ("target", "role"): ("residuals", ("count", "rejected", "rms_um", "max_um")),
    ("row", "target", "role"): ("rows", ("residual_um", "time_min", None)),
    ("distances between",): ("predicted_distance.all", ("count", "lengths_mm", *EXPECTED)),
    ("distance",): ("validation.distances", (*DISTANCE, "predicted_sd_um", "predicted_interval95_um", None)),
    ("distances",): ("validation.distances", (*DISTANCE, "predicted_interval95_um", None)),
    ("diameter of",): ("validation.diameters", (*DISTANCE, "predicted_interval95_um", None)),
    ("target",): ("validation.planes",
                  ("count", "nominal_rms_um", "calibrated_rms_um", "calibrated_max_um", "predicted_rms_um")),
    ("model",): ("ladder", tuple(key for key in LEVEL if "interval" not in key)),
    ("validation (µm)",): ("ladder", LEVEL),
    ("quantity",): ("iso9283.figures", ACCURACY),
    ("ISO 9283 (validation measurements)",): ("iso9283.figures", ACCURACY),
    ("parameter",): ("parameters", NUMBERS),
    ("parameter", "parameter"): ("correlations", ("r",)),
    ("test",): ("verdict.tests", ("value", "limit", "p")),
}  # fmt: skip
"""Headings of a table that name its rows: where its figures are in the record, column by column."""
NOT_HERE = ("component", "measurand")
"""Tables of budget.json: tests/assess/test_budget.py."""
FIGURE = re.compile(r"([+-]?\d+(?:\.(\d+))?)(?:\((\d+(?:\.\d+)?)\))?")


NAMES = (("a", "b"), ("id", "target", "role"), ("target", "role"))
NAMES += tuple((name,) for name in ("over", "words", "name", "target"))
"""Keys of the first cells of the rows of a table."""


def named(item):
    """The first cells of the rows of a record's item."""
    if "between" in item:
        return [f" {sign} ".join(item["between"]) for sign in "-–"]
    if "symbol" in item:
        return [f"{item['symbol']}: {item['name']}"]
    for keys in NAMES:
        if all(key in item for key in keys):
            cells = [str(ROLES.get(item[key], item[key])) for key in keys]
            return ["|".join(cells), cells[0]]
    return ["joint offsets" if item["model"] == ["joint"] else " + ".join(item["model"])]


def items_of(record, path):
    for key in path.split("."):
        record = record[key]
    if path != "rows":
        return record
    keys = ("id", "target", "role", "residual_um", "time_s")
    every = [record[key] or [None] * len(record["id"]) for key in keys]
    rows = [dict(zip(keys, row, strict=True)) for row in zip(*every, strict=True)]
    return [row | {"time_min": row["time_s"] and row["time_s"] / 60.0} for row in rows]


def figures(cell):
    """Figures of a cell, with their rounding; of two digits where they have no decimals."""
    for text, decimals, u in FIGURE.findall(cell.replace(" to ", " ")):
        rounding = 0.51 * 10.0 ** -len(decimals)
        yield float(text), rounding + (0 if decimals else 0.051 * abs(float(text)))
        if u:
            yield float(u) * (1.0 if "." in u else 10.0 ** -len(decimals)), rounding


def checked(cells, record):
    """Whether the figures of a table are those of the record; of a table without a rule, its heading."""
    heading, *rows = cells
    title = max((key for key in SHEETS if tuple(heading[: len(key)]) == key), key=len, default=None)
    if title is None:
        assert heading[0] in NOT_HERE, heading
        return
    path, columns = SHEETS[title]
    found = {name: item for item in items_of(record, path) for name in named(item)}
    assert rows, heading
    for row in rows:
        item, shown = found["|".join(row[: len(title)])], row[len(title) :]
        keys = [k for k in columns if path != "ladder" or any(x.get(k) is not None for x in record["ladder"])]
        for key, cell in zip(keys, shown, strict=path not in ("ladder", "parameters")):
            wanted = [item.get(k) for k in (key if isinstance(key, tuple) else [key])]
            wanted = [x for w in wanted for x in (w if isinstance(w, list) else [w]) if x is not None]
            got = list(figures(cell))
            if key is not None and not (cell in ("", "-") and not wanted):
                assert len(got) == len(wanted), (heading, row)
                for (value, rounding), number in zip(got, wanted, strict=True):
                    assert value == pytest.approx(number, abs=rounding), (heading, row, key)


def of_page(page):
    bare = re.sub(r"<(script|style)\b.*?</\1>", "", page, flags=re.DOTALL)
    for table in re.findall(r"<table.*?</table>", bare, re.DOTALL):
        cells = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL) for row in table.split("</tr>")]
        yield [[html.unescape(re.sub("<[^>]+>", "", c)).strip() for c in row] for row in cells if row]


def of_terminal(text):
    table = []
    for line in [*text.splitlines(), ""]:
        cells = re.split(r"\s{2,}", line.strip())
        if (len(cells) - len(table[0]) in (0, 1)) if table else (len(cells) > 1 and (cells[0],) in SHEETS):
            table.append(cells)
        elif table:
            yield table
            table = []


def test_tables_show_the_figures_of_the_record(run):
    """On the page and on the terminal: every cell of every table."""
    console = Console(width=300, record=True, file=io.StringIO())
    console.print(run.result.report(verbose=True))
    page = (run.folder / "report.html").read_text(encoding="utf-8")
    shown = {"page": list(of_page(page)), "terminal": list(of_terminal(console.export_text()))}
    assert len(shown["page"]) > 8
    assert len(shown["terminal"]) > 2
    for table in (*shown["page"], *shown["terminal"]):
        checked(table, run.record)
