"""Tables of a result, made from its record; the same for a new result and a saved one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pandas import DataFrame

Json = Mapping[str, Any]
LEVELS = {"determined": "yes", "partly": "weakly", "prior_only": "no"}
"""Lists of fit.json -> value of the column `identifiable`."""


class FitTables:
    """Tables of a calibration; lengths and angles in the units that the columns state.

    `record` is the content of fit.json.
    """

    @property
    def record(self) -> Json:
        """The content of fit.json."""
        raise NotImplementedError

    @property
    def parameters(self) -> DataFrame:
        """One row per parameter, by name.

        Columns: `effect`, `unit`, `nominal`, `estimate`, `u` (posterior standard uncertainty), `prior_sd`,
        `low95` and `high95` (ends of the 95 % interval), and `identifiable` ("yes", "weakly", "no"; empty
        for the pose of a target).
        """
        from pandas import DataFrame

        known = self.record["identifiability"]
        level = {name: word for key, word in LEVELS.items() for name in known[key]}
        rows = [
            {
                "name": p["name"],
                "effect": p["effect"],
                "unit": p["unit"],
                "nominal": p["nominal"],
                "estimate": p["estimate"],
                "u": p["sd"],
                "prior_sd": p["prior_sd"],
                "low95": p["interval95"][0],
                "high95": p["interval95"][1],
                "identifiable": level.get(p["name"], ""),
            }
            for p in self.record["parameters"]
        ]
        return DataFrame(rows).set_index("name")

    @property
    def levels(self) -> DataFrame:
        """Validation errors by model level, from the nominal model to the fitted one; keys of fit.json."""
        from pandas import DataFrame

        rows = [{**level, "model": " + ".join(level["model"])} for level in self.record["ladder"]]
        return DataFrame(rows).set_index("model")

    @property
    def distances(self) -> DataFrame:
        """Certified distances, measured and predicted: `certified_mm`, errors and intervals in µm."""
        from pandas import DataFrame

        rows = [
            {
                "from": d["between"][0],
                "to": d["between"][1],
                "certified_mm": d["certified_mm"],
                "nominal_error_um": d["nominal_error_um"],
                "calibrated_error_um": d["calibrated_error_um"],
                "predicted_sd_um": d["predicted_sd_um"],
                "low95_um": d["predicted_interval95_um"][0],
                "high95_um": d["predicted_interval95_um"][1],
                "inside95": d["inside95"],
            }
            for d in self.record["validation"]["distances"]
        ]
        return DataFrame(rows)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Limitations of the results."""
        return tuple(self.record["warnings"])

    def _repr_html_(self) -> str:
        return f"<p>{_escaped(repr(self))}</p>{self.parameters.to_html(float_format='%.6g')}"


class GapTables:
    """Tables of a diagnosis, made of the content of gap.json."""

    @property
    def record(self) -> Json:
        """The content of gap.json."""
        raise NotImplementedError

    @property
    def verdict(self) -> str:
        """The kind of verdict: null, named, named+unexplained, unknown or ambiguous."""
        return str(self.record["verdict"])

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the verdict."""
        return tuple(self.record["effects"])

    @property
    def probability(self) -> DataFrame:
        """Probability of every effect, of the noise-only model ('null') and of an unmodelled effect."""
        from pandas import DataFrame

        ranked = sorted(self.record["probability"].items(), key=lambda item: -(item[1] or 0.0))
        return DataFrame(ranked, columns=["effect", "probability"]).set_index("effect")

    @property
    def undecided(self) -> bool:
        """Whether further contacts could decide: effects not separated, not confirmed or not known."""
        unexplained = self.verdict in ("ambiguous", "unknown", "named+unexplained")
        return unexplained or bool(self.record.get("undecided"))

    @property
    def amplitudes(self) -> DataFrame:
        """Named effects, site by site: `what`, `value`, `u` (standard uncertainty) and `unit`; see gap.md."""
        from pandas import DataFrame

        return DataFrame(list(self.record.get("amplitudes", ())))

    @property
    def where(self) -> DataFrame:
        """Locations of the error, largest first: site, driver, `rms_um`, share of the excess, p-values."""
        from pandas import DataFrame

        return DataFrame(list(self.record["where"]))

    @property
    def shrinkage(self) -> DataFrame:
        """Validation errors without and with the named effects in the model, in µm."""
        from pandas import DataFrame

        rows = {what: row for what, row in self.record["shrinkage"].items() if row}
        return DataFrame.from_dict(rows, orient="index")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Limitations of the verdict."""
        return tuple(self.record["warnings"])

    def _repr_html_(self) -> str:
        return f"<p>{_escaped(repr(self))}</p>{self.probability.to_html(float_format='%.3g')}"


class PlanTables:
    """Tables of a plan, made of the content of plan.json."""

    @property
    def record(self) -> Json:
        """The content of plan.json."""
        raise NotImplementedError

    @property
    def distances(self) -> DataFrame:
        """Expected standard uncertainty of distances, µm, of the plan and of a random selection; shares."""
        from pandas import DataFrame

        rows = [
            {key: value for key, value in d.items() if key != "shares"} | d["shares"]
            for d in self.record["expected"]["distances"]
        ]
        return DataFrame(rows, columns=None if rows else ["over"]).set_index("over")

    @property
    def parameters(self) -> DataFrame:
        """Expected standard uncertainty `u` of the parameters, by name, and that of their prior."""
        from pandas import DataFrame

        columns = ["name", "unit", "u", "prior_u"]
        return DataFrame(list(self.record["expected"]["parameters"]), columns=columns).set_index("name")

    @property
    def detectable(self) -> DataFrame:
        """Smallest detectable amplitude of each effect and site, of the plan and of a random selection."""
        from pandas import DataFrame

        return DataFrame(list(self.record["detectable"]))

    @property
    def confusable(self) -> DataFrame:
        """Pairs of effects: detectability before and with the plan, and what would separate them."""
        from pandas import DataFrame

        return DataFrame(list(self.record["confusable"]))

    @property
    def curve(self) -> DataFrame:
        """Expected standard uncertainty of distances, µm, by number of contacts: `plan` and `random`."""
        from pandas import DataFrame

        both = {"plan": self.record["curve"], "random": self.record["curve_random"]}
        return DataFrame(
            {
                name: {point["contacts"]: point["distance_sd_um"] for point in points}
                for name, points in both.items()
            }
        ).rename_axis("contacts")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Limitations of the plan."""
        return tuple(self.record["warnings"])

    def contacts_of(self, table: Any) -> DataFrame:
        """The contacts of plan.csv (a path or a file) with their purpose."""
        from pandas import read_csv

        out = read_csv(
            table, dtype={"id": str, "repeat": str, "target": str, "tool": str}, keep_default_na=True
        )
        out["purpose"] = out["id"].map(self.record["purpose"])
        return out.set_index("id")

    def _repr_html_(self) -> str:
        return f"<p>{_escaped(repr(self))}</p>{self.distances.to_html(float_format='%.3g')}"


def fit_line(record: Json) -> str:
    """A calibration in one line."""
    rms, where = record["predicted_distance"]["predicted_rms_um"], record["dataset"]["name"]
    model = ", ".join(record["model"])
    return f"<calibration of {where}: {model}; predicted distance error {rms:.1f} µm RMS>"


def gap_line(record: Json) -> str:
    """A diagnosis in one line."""
    found = ", ".join(record["effects"]) or ", ".join(record["credible_set90"])
    return f"<diagnosis of {record['dataset']['name']}: {record['verdict']}; {found}>"


def plan_line(record: Json) -> str:
    """A plan in one line."""
    expected = record["expected"]
    u = expected["distance_sd_um"]
    size = "" if u is None else f"; expected U {2 * u:.1f} µm (k = 2), {expected['over']}"
    return f"<plan of {record['dataset']['name']}: {record['contacts']} contacts{size}>"


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
