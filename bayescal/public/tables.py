"""Tables of a result, made from its record; the same for a new result and a saved one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from bayescal.storage.reading import Json

if TYPE_CHECKING:
    from pandas import DataFrame


def _frame(
    entries: Iterable[Json], *keys: str, index: str | None = None, **others: str | Callable[[Json], Any]
) -> DataFrame:
    """Entries of a record as a table: of all their keys, or of `keys` and of `others` by name."""
    from pandas import DataFrame

    from bayescal.reporting.shared.sheet import Column, Sheet, frame

    columns = tuple(Column(name, of) for name, of in (dict(zip(keys, keys, strict=True)) | others).items())
    if columns:
        return frame(Sheet(columns, tuple(entries)), index)
    out = DataFrame(list(entries))
    return out.set_index(index) if index else out


class _Tables:
    """What the tables of all results have."""

    _FORMAT = "%.6g"
    """Of the numbers of `_overview`."""

    @property
    def record(self) -> Json:
        """The content of the record: fit.json, gap.json or plan.json."""
        raise NotImplementedError

    @property
    def warnings(self) -> tuple[str, ...]:
        """Limitations of the result."""
        return tuple(self.record["warnings"])

    @property
    def _overview(self) -> DataFrame:
        """The table that a notebook shows."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self), quote=False)}</p>{self._overview.to_html(float_format=self._FORMAT)}"


class FitTables(_Tables):
    """Tables of a calibration; lengths and angles in the units that the columns state."""

    @property
    def parameters(self) -> DataFrame:
        """One row per parameter, by name.

        Columns: `effect`, `unit`, `nominal`, `estimate`, `u` (posterior standard uncertainty), `prior_sd`,
        `low95` and `high95` (ends of the 95 % interval), and `identifiable` ("yes", "weakly", "no"; empty
        for the pose of a target).
        """
        from bayescal.reporting.fit.sheets import states

        state = states(self.record["identifiability"])
        return _frame(
            self.record["parameters"],
            *("name", "effect", "unit", "nominal", "estimate"),
            index="name",
            u="sd",
            prior_sd="prior_sd",
            low95=lambda p: p["interval95"][0],
            high95=lambda p: p["interval95"][1],
            identifiable=lambda p: state.get(p["name"], ""),
        )

    _overview = parameters

    @property
    def levels(self) -> DataFrame:
        """Validation errors by model level, from the nominal model to the fitted one; keys of fit.json."""
        levels = ({**level, "model": " + ".join(level["model"])} for level in self.record["ladder"])
        return _frame(levels, index="model")

    @property
    def distances(self) -> DataFrame:
        """Certified distances, measured and predicted: `certified_mm`, errors and intervals in µm."""
        ends: dict[str, Any] = {"from": lambda d: d["between"][0], "to": lambda d: d["between"][1]}
        same = ("certified_mm", "nominal_error_um", "calibrated_error_um", "predicted_sd_um")
        return _frame(
            self.record["validation"]["distances"],
            **ends,
            **dict(zip(same, same, strict=True)),
            low95_um=lambda d: d["predicted_interval95_um"][0],
            high95_um=lambda d: d["predicted_interval95_um"][1],
            inside95="inside95",
        )


class GapTables(_Tables):
    """Tables of a diagnosis."""

    _FORMAT = "%.3g"

    @property
    def verdict(self) -> str:
        """The kind of verdict: null, named, named+unexplained, class, unknown or ambiguous."""
        return str(self.record["verdict"])

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the verdict."""
        return tuple(self.record["effects"])

    @property
    def probability(self) -> DataFrame:
        """Probability of every effect, of the noise-only model ('null') and of an unmodelled effect."""
        ranked = sorted(self.record["probability"].items(), key=lambda item: -(item[1] or 0.0))
        entries = ({"effect": effect, "probability": p} for effect, p in ranked)
        return _frame(entries, "effect", "probability", index="effect")

    _overview = probability

    @property
    def undecided(self) -> bool:
        """Whether further contacts could decide: effects not separated, not confirmed or not known."""
        unexplained = self.verdict not in ("null", "named")
        return unexplained or bool(self.record.get("undecided"))

    @property
    def amplitudes(self) -> DataFrame:
        """Named effects, site by site: `what`, `value`, `u` (standard uncertainty) and `unit`; see gap.md."""
        return _frame(self.record.get("amplitudes", ()))

    @property
    def where(self) -> DataFrame:
        """Locations of the error, largest first: site, driver, `rms_um`, share of the excess, p-values."""
        return _frame(self.record["where"])

    @property
    def shrinkage(self) -> DataFrame:
        """Validation errors without and with the named effects in the model, in µm."""
        from pandas import DataFrame

        rows = {what: row for what, row in self.record["shrinkage"].items() if row}
        return DataFrame.from_dict(rows, orient="index")


class PlanTables(_Tables):
    """Tables of a plan."""

    _FORMAT = "%.3g"

    @property
    def distances(self) -> DataFrame:
        """Expected standard uncertainty of distances, µm, of the plan and of a random selection; shares."""
        from pandas import DataFrame

        rows = [
            {key: value for key, value in d.items() if key != "shares"} | d["shares"]
            for d in self.record["expected"]["distances"]
        ]
        return DataFrame(rows, columns=None if rows else ["over"]).set_index("over")

    _overview = distances

    @property
    def parameters(self) -> DataFrame:
        """Expected standard uncertainty `u` of the parameters, by name, and that of their prior."""
        columns = ("name", "unit", "u", "prior_u")
        return _frame(self.record["expected"]["parameters"], *columns, index="name")

    @property
    def detectable(self) -> DataFrame:
        """Smallest detectable amplitude of each effect and site, of the plan and of a random selection."""
        return _frame(self.record["detectable"])

    @property
    def confusable(self) -> DataFrame:
        """Pairs of effects: detectability before and with the plan, and what would separate them."""
        return _frame(self.record["confusable"])

    @property
    def curve(self) -> DataFrame:
        """Expected standard uncertainty of distances, µm, by number of contacts: `plan` and `random`."""
        from pandas import DataFrame

        curves = {
            name: {point["contacts"]: point["distance_sd_um"] for point in self.record[key]}
            for name, key in (("plan", "curve"), ("random", "curve_random"))
        }
        return DataFrame(curves).rename_axis("contacts")

    def contacts_of(self, table: Any) -> DataFrame:
        """The contacts of plan.csv (a path or a file) with their purpose."""
        from pandas import read_csv

        texts: Mapping[Any, Any] = dict.fromkeys(("id", "repeat", "target", "tool"), str)
        out = read_csv(table, dtype=texts, keep_default_na=True)
        out["purpose"] = out["id"].map(self.record["purpose"])
        return out.set_index("id")


def fit_line(record: Json) -> str:
    """A calibration in one line."""
    rms, where = record["predicted_distance"]["predicted_rms_um"], record["dataset"]["name"]
    model = ", ".join(record["model"])
    return f"<calibration of {where}: {model}; predicted distance error {rms:.1f} µm RMS>"


def gap_line(record: Json) -> str:
    """A diagnosis in one line."""
    names = ", ".join(record["effects"]) or ", ".join(record["credible_set90"])
    return f"<diagnosis of {record['dataset']['name']}: {record['verdict']}; {names}>"


def plan_line(record: Json) -> str:
    """A plan in one line."""
    expected = record["expected"]
    u = expected["distance_sd_um"]
    size = "" if u is None else f"; expected U {2 * u:.1f} µm (k = 2), {expected['over']}"
    return f"<plan of {record['dataset']['name']}: {record['contacts']} contacts{size}>"
