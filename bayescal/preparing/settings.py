"""Text of a commented dataset.yaml: every key explained, values that are not known yet marked."""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bayescal.dataset import Certificate, PlanSettings, Target, Tool
from bayescal.dataset.schema import (
    CERTIFICATES,
    SCHEMA,
    DatasetFile,
    Loose,
    NoiseEntry,
    PlanEntry,
    RecordEntry,
    SerialsEntry,
    ToolEntry,
    entry_of,
)
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.write import certificate_keys, plan_block, target_keys, tool_keys
from bayescal.preparing.artefacts import ARTEFACTS, Outline
from bayescal.probing.artefacts import TOOL
from bayescal.storage.files import FILL_IN, stem_of
from bayescal.storage.files import Keys as Model
from bayescal.storage.writing import block_lines, flow, scalar

WIDTH = 110
EXAMPLES = {"probe": TOOL, "reflector": Tool("reflector", TOOL.centre, None, TOOL.mass, TOOL.centre_of_mass)}
SAME = "Each value is filled in once: * stands for the value with the same & above."
NOISE = {"contact": ("contact_mm", "0.005"), "point": ("point_mm", "0.020")}
"""Key of the noise of each kind of residual, and an example of its value."""
RECORD = {
    "date": "2026-01-31",
    "operator": "name",
    "serials": f"{{{', '.join(f'{key}: no.' for key in SerialsEntry.model_fields)}}}",
    "certificates": "[no.]",
    "temperature_degC": "20.0",
}
"""Keys of `record` with examples."""
HEAD = (
    "Set-up of a measuring session for bayescal. The units are in the keys (mm, deg, rad, kg); lengths and "
    "angles refer to F0, the base frame of the robot.",
    f"{FILL_IN} marks a value that only you know, from a certificate or a measurement. The number behind it "
    "is an example. Write your value and delete the mark. `bayescal check`, `fit` and `gap` refuse this file "
    "until no mark is left; `bayescal plan` assumes the examples, and says so.",
    "Values that are called nominal can stay: they are proposals that the robot reaches, and the fit "
    "estimates the true values. Put the artefact there within 50 mm and 0.2 rad, or write where it is. "
    "Change them if your artefact has other dimensions.",
)


@dataclass(frozen=True)
class Draft:
    """A set-up to be written.

    Attributes
    ----------
    name : str
        Of the session.
    robot : str
        Built-in name, or file beside dataset.yaml.
    joints : int
        Number of joints.
    outlines : mapping of str to Outline
        By the name of the artefact.
    tool_centre : np.ndarray or None, shape (3,)
        Of the ball or reflector in the flange frame, m; None: to be filled in.
    placed : bool
        Whether the places of the targets are reached by the robot; False: to be filled in.
    schema : str
        Name of the file beside dataset.yaml that describes it to editors.
    """

    name: str
    robot: str
    joints: int
    outlines: dict[str, Outline]
    tool_centre: np.ndarray | None
    placed: bool
    schema: str

    @property
    def tools(self) -> tuple[str, ...]:
        """Names of the tools."""
        return tuple(dict.fromkeys(ARTEFACTS[name].tool for name in self.outlines))

    @property
    def targets(self) -> tuple[Target, ...]:
        """Of all artefacts."""
        return tuple(t for outline in self.outlines.values() for t in outline.targets)


def settings_text(draft: Draft) -> str:
    """The content of dataset.yaml."""
    lines = [f"# yaml-language-server: $schema={draft.schema}", *_comment("\n\n".join(HEAD)), ""]
    for key, value in (("schema", SCHEMA), ("name", scalar(draft.name)), ("robot", scalar(draft.robot))):
        lines += [*_explained(DatasetFile, key), f"{key}: {value}"]
    lines += [*_explained(DatasetFile, "readings"), "readings: encoder"]
    lines += [*_explained(DatasetFile, "gravity_mps2"), "gravity_mps2: [0, 0, -9.81]  # nominal", ""]
    lines += [*_tools(draft), "", *_noise(draft), "", *_targets(draft), "", *_certificates(draft), ""]
    lines += [
        *_optional(DatasetFile, "artefact", "artefact.yaml"),
        *_optional(DatasetFile, "temperature_of", "arm"),
        *_optional(DatasetFile, "torques", "measured"),
    ]
    lines += [
        *_plan(draft),
        *_record(),
        *_optional(DatasetFile, "source", "measured on ..., by ..., probe ..., certificate no. ..."),
    ]
    return "\n".join(lines) + "\n"


def _comment(text: str, indent: int = 0) -> list[str]:
    out = []
    for line in text.splitlines():
        out += textwrap.wrap(line, WIDTH - indent - 2) or [""]
    return [f"{' ' * indent}# {line}".rstrip() for line in out]


def _explained(model: type[Model], key: str, indent: int = 0) -> list[str]:
    """The description of a key as a comment."""
    fields = {field.alias or name: field for name, field in model.model_fields.items()}
    return _comment(fields[key].description or "", indent)


def _optional(model: type[Model], key: str, example: str, indent: int = 0) -> list[str]:
    """A key that may be left out, as a comment."""
    return [*_explained(model, key, indent), f"{' ' * indent}# {key}: {example}"]


def _tools(draft: Draft) -> Iterator[str]:
    yield from _explained(DatasetFile, "tools")
    yield "tools:"
    for name in draft.tools:
        yield f"  {name}:"
        for key, text in tool_keys(EXAMPLES[name]):
            yield from _explained(ToolEntry, key, 4)
            if key == "centre_mm" and draft.tool_centre is not None:
                yield f"    {key}: {dict(tool_keys(Tool(name, draft.tool_centre)))[key]}  # nominal"
            else:
                yield f"    {key}: {FILL_IN} {text}"
        yield from _optional(ToolEntry, "u_mm", "1.0", 4)
        yield from _optional(ToolEntry, "rpy_deg", "[0, 0, 0]", 4)


def _noise(draft: Draft) -> Iterator[str]:
    yield from _explained(DatasetFile, "noise")
    yield from _comment("Measure it: repeat some contacts, and take the standard deviation of their scatter.")
    yield "noise:"
    for kind in dict.fromkeys(KINDS[t.kind].noise for t in draft.targets):
        key, example = NOISE[kind]
        yield from _explained(NoiseEntry, key, 2)
        yield f"  {key}: {FILL_IN} {example}"
    yield from _optional(NoiseEntry, "joint_deg", "0.001", 2)


def _targets(draft: Draft) -> Iterator[str]:
    yield from _explained(DatasetFile, "targets")
    kinds = dict.fromkeys(KINDS[t.kind] for t in draft.targets)
    for kind in kinds:
        yield from _comment(f"{kind.name}: {kind.summary.replace('``', '`')}")
        for key in kind.keys:
            description = entry_of(kind).model_fields[key].description
            yield from _comment(f"  {key}: {description}")
    for key in Loose.model_fields:
        yield from _comment(f"  {key} (optional): {Loose.model_fields[key].description}")
    yield "targets:"
    uses = Counter(
        _of_target(t, key)
        for name, outline in draft.outlines.items()
        for t in outline.targets
        for key in ARTEFACTS[name].certified
    )
    once = Once(uses)
    for artefact, outline in draft.outlines.items():
        yield from _comment(f"{artefact}: {ARTEFACTS[artefact].summary}.", 2)
        certified = ARTEFACTS[artefact].certified
        if certified:
            yield from _comment(f"`{certified[0]}` is that of the certificate. {SAME}", 2)
        for target in outline.targets:
            items = []
            for key, text in target_keys(target):
                if key in certified:
                    text = once.text(_of_target(target, key), text)
                elif key != "kind" and not draft.placed:
                    text = f"{FILL_IN} ''"
                items.append((key, text))
            yield f"  {scalar(target.name)}: {flow(items)}{'  # nominal' if draft.placed else ''}"


def _certificates(draft: Draft) -> Iterator[str]:
    stated = {name: o.certificates for name, o in draft.outlines.items() if o.certificates}
    yield from _explained(DatasetFile, "certificates")
    if not stated:
        why = "no certified distance is validated"
        yield from _comment(f"This artefact has none beyond its own entry: {why}.")
        return
    every = [c for certificates in stated.values() for c in certificates]
    for kind in dict.fromkeys(c.kind for c in every):
        model = CERTIFICATES[kind]
        yield from _comment(f"{kind}: {model.__doc__}")
        for key, about in model.model_fields.items():
            if about.description and stem_of(key)[1]:
                yield from _comment(f"  {key}: {about.description}")
    once = Once(Counter(_of_certificate(c, key) for c in every for key in CERTIFICATES[c.kind].model_fields))
    yield from _comment(SAME)
    yield "certificates:"
    for name, certificates in stated.items():
        yield from _comment(f"{name}: from its calibration certificate; u = U / k.", 2)
        for certificate in certificates:
            items = (
                (key, once.text(_of_certificate(certificate, key), text) if stem_of(key)[1] else text)
                for key, text in certificate_keys(certificate)
            )
            yield f"  - {flow(items)}"


@dataclass(frozen=True)
class Once:
    """Marked values, each to be filled in once: `uses` counts the entries that share one, by its name."""

    uses: Mapping[str, int]
    given: set[str] = field(default_factory=set)

    def text(self, name: str, text: str) -> str:
        """The marked value, or a reference to it where it was given before."""
        if name in self.given:
            return f"*{name} "  # the space: a comma may belong to the name
        self.given.add(name)
        return f"&{name} {FILL_IN} {text}" if self.uses[name] > 1 else f"{FILL_IN} {text}"


def _plain(name: str) -> str:
    """The name of a target without its placement, in the characters that libyaml allows in an anchor."""
    return re.sub(r"[^A-Za-z0-9]", "", name.partition("@")[0])


def _of_target(target: Target, key: str) -> str:
    return f"{_plain(target.name)}-{stem_of(key)[0]}"


def _of_certificate(certificate: Certificate, key: str) -> str:
    """Name of a certified value: a kind shares its uncertainties, the placements of a pair its value."""
    stem = stem_of(key)[0]
    pair = "-".join(_plain(name.rpartition(".")[2]) for name in certificate.targets)
    return f"{certificate.kind}-{stem}" if stem.startswith("u_") else f"{certificate.kind}-{pair}"


def _plan(draft: Draft) -> Iterator[str]:
    regions = {name: p for outline in draft.outlines.values() for name, p in outline.regions.items()}
    yield from _explained(DatasetFile, "plan")
    for key in PlanEntry.model_fields:
        yield from _comment(f"  {key}: {PlanEntry.model_fields[key].description}")
    if regions and draft.placed:
        yield from block_lines({"plan": plan_block(PlanSettings(regions=regions))})
    else:
        yield "# plan:"
        yield "#   payload_kg: [2.0]"


def _record() -> Iterator[str]:
    """What a filed report states, as comments: each key with an example."""
    yield from _explained(DatasetFile, "record")
    yield "# record:"
    for key, example in RECORD.items():
        yield f"#   {key}: {example}  # {RecordEntry.model_fields[key].description}"


def schema_name(path: Path) -> str:
    """The file beside a YAML file that describes it to editors."""
    return f".{path.stem}.schema.json"
