"""The folder of a new session: a commented dataset.yaml, measurements.csv, README.md, robot.yaml.

Values that are not known yet are marked, each once.
"""

import re
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, starmap
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import Certificate, PlanSettings, Target, Tool, schema
from bayescal.dataset.read import SETTINGS, TABLE
from bayescal.dataset.table import COLUMNS, JOINT, known_columns
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.write import ROBOT, certificate_keys, plan_block, target_keys, tool_keys
from bayescal.errors import BayescalError
from bayescal.preparing.artefacts import ARTEFACTS, JOINTS, ON_SPHERE, Artefact, Outline, Room, schema_text
from bayescal.probing.scene import Sizes
from bayescal.robots import builtin_robots, full_name, load_robot, only_one_arm, robot_to_yaml
from bayescal.robots import schema as robot_schema
from bayescal.statistics import grouped
from bayescal.storage.files import FILL_IN, stem_of
from bayescal.storage.folders import filled
from bayescal.storage.writing import block_lines, flow, scalar, templates_beside

WIDTH = 110
"""Characters of a line of a comment."""
NOISE = {"contact": ("contact_mm", "0.005"), "point": ("point_mm", "0.020")}
"""Key of the noise of each kind of residual, and an example of its value."""


def _comment(text: str, indent: int = 0) -> str:
    lead = f"{' ' * indent}# "
    return "\n".join(lead + line for line in textwrap.wrap(text, WIDTH - len(lead)))


def _about(fields: Mapping[str, Any], key: str, indent: int = 0) -> str:
    """The description of a key as a comment."""
    return _comment(fields[key].description, indent)


def _listed(fields: Mapping[str, Any], key: str, label: str = "") -> str:
    """A key, or a label in its place, and its description as a comment."""
    return _comment(f"  {label or key}: {fields[key].description}")


TEMPLATES = templates_beside(
    __file__,
    {
        "comment": _comment,
        "about": _about,
        "listed": _listed,
        "scalar": scalar,
        "has_unit": lambda key: bool(stem_of(key)[1]),
    },
)
"""They describe keys by the fields of their models."""


def rendered(template: str, **values: Any) -> str:
    """The text of a template."""
    return TEMPLATES.get_template(template).render(fill=FILL_IN, **values)


@dataclass(frozen=True)
class Draft:
    """A set-up to be written.

    Attributes
    ----------
    name : str
        Of the session.
    robot : str
        Built-in name, or file beside dataset.yaml.
    units : tuple of str
        Unit of each joint's reading, deg or mm.
    outlines : mapping of str to Outline
        By the name of the artefact.
    tool_centre : np.ndarray or None, shape (3,)
        Of the ball or reflector in the flange frame, m; None: to be filled in.
    example : Tool
        A tool that suits the robot: its values stand where none are known yet.
    placed : bool
        Whether the places of the targets are reached by the robot; False: to be filled in.
    """

    name: str
    robot: str
    units: tuple[str, ...]
    outlines: dict[str, Outline]
    tool_centre: np.ndarray | None
    example: Tool
    placed: bool

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
    regions = {name: p for outline in draft.outlines.values() for name, p in outline.regions.items()}
    planned = regions and draft.placed
    plan = {"plan": plan_block(PlanSettings(regions=regions), draft.units)} if planned else {}
    stated = {name: o.certificates for name, o in draft.outlines.items() if o.certificates}
    kinds = dict.fromkeys(KINDS[t.kind] for t in draft.targets)
    return rendered(
        "dataset.yaml.j2", draft=draft, models=schema,
        tools={name: _tool(draft, name) for name in draft.tools},
        stated_noise=[NOISE[noise] for noise in dict.fromkeys(kind.noise for kind in kinds)],
        kinds={kind: schema.entry_of(kind).model_fields for kind in kinds}, targets=_targets(draft),
        certified={c.kind: schema.CERTIFICATES[c.kind] for each in stated.values() for c in each},
        certificates=_certificates(stated), regions=[*block_lines(plan)],
    )  # fmt: skip


def _tool(draft: Draft, name: str) -> dict[str, str]:
    """Keys of a tool with marked examples; the centre that is given is not marked."""
    radius = draft.example.ball_radius if name == "probe" else None
    example = replace(draft.example, name=name, ball_radius=radius)
    entry = {key: f"{FILL_IN} {text}" for key, text in tool_keys(example)}
    if draft.tool_centre is not None:
        entry["centre_mm"] = dict(tool_keys(Tool(name, draft.tool_centre)))["centre_mm"] + "  # nominal"
    return entry


def _targets(draft: Draft) -> list[tuple[Artefact, dict[str, str]]]:
    """The entries of the targets of each artefact, by name."""
    artefacts = [(ARTEFACTS[name], outline.targets) for name, outline in draft.outlines.items()]
    certified = ((t, key) for each, targets in artefacts for t in targets for key in each.certified)
    once = Once(Counter(starmap(_of_target, certified)))

    def entry(target: Target, artefact: Artefact) -> str:
        items = dict(target_keys(target))
        for key, text in items.items():
            if key in artefact.certified:
                items[key] = once.text(_of_target(target, key), text)
            elif key != "kind" and not draft.placed:
                items[key] = f"{FILL_IN} ''"
        return flow(items.items())

    return [(each, {t.name: entry(t, each) for t in targets}) for each, targets in artefacts]


def _certificates(stated: Mapping[str, tuple[Certificate, ...]]) -> dict[str, list[str]]:
    """The entries of the certificates by artefact."""
    every = [c for certificates in stated.values() for c in certificates]
    keys = {kind: model.model_fields for kind, model in schema.CERTIFICATES.items()}
    once = Once(Counter(_of_certificate(c, key) for c in every for key in keys[c.kind]))

    def entry(certificate: Certificate) -> str:
        return flow(
            (key, once.text(_of_certificate(certificate, key), text) if stem_of(key)[1] else text)
            for key, text in certificate_keys(certificate)
        )

    return {name: [entry(c) for c in certificates] for name, certificates in stated.items()}


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


def columns_of(draft: Draft) -> dict[str, tuple[str, ...]]:
    """Columns of measurements.csv by key of `COLUMNS`.

    They are those needed, and those that make more effects assessable.
    """
    keys = {"id", "role", "target", "jN_deg", "jN_degps", "stop", "time_s", "payload_kg", "repeat"}
    keys |= {c for name in draft.outlines for c in ARTEFACTS[name].columns}
    keys |= {"tool"} if len(draft.tools) > 1 else set()
    keys |= {f"jN_{JOINT[kind]}" for kind in ("deg", "degps")}
    every = grouped((re.sub(r"^j\d+", "jN", column), column) for column in known_columns(draft.units))
    return {key: tuple(every[key]) for key in COLUMNS if key in keys and key in every}


README, SCHEMA_OF_ROBOT = "README.md", ".robot.schema.json"
NEW = "new"
"""Robot that is not described yet: a robot.yaml to be filled in is written."""
STAND_IN = "fanuc-lrmate200ic"
"""Robot that gives the targets of a new robot their form; their places are to be filled in."""


def start(
    folder: Path, robot: str, artefacts: Sequence[str], tool: np.ndarray | None = None, name: str = "",
    arm: Robot | None = None,
) -> tuple[str, ...]:  # fmt: skip
    """Write the set-up of a new session atomically, and return the names of its files.

    Parameters
    ----------
    folder : Path
        A new or an empty folder.
    robot : str
        A built-in name or a part of it (``ur5e``), a robot.yaml, URDF or xacro, or ``new``.
    artefacts : sequence of str
        Names of `ARTEFACTS`.
    tool : np.ndarray, optional, shape (3,)
        Centre of the ball or reflector in the flange frame, m; to be filled in if not given.
    name : str
        Of the session; default: the name of the folder.
    arm : Robot, optional
        That of `robot`, if this is a xacro file.

    Raises
    ------
    BayescalError
        If the folder is not empty, the robot or an artefact is not known, or the arm is too small.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BayescalError("it exists already and is not empty", str(folder), "give a new folder")
    remedy = f"known: {', '.join(ARTEFACTS)}"
    for each in artefacts:
        if each not in ARTEFACTS:
            raise BayescalError(f"no artefact is called `{each}`", "--artefact", remedy)
    if not artefacts or len(set(artefacts)) < len(artefacts):
        raise BayescalError("each artefact is named once", "--artefact", remedy)
    described = robot != NEW
    reference = full_name(robot) if described else STAND_IN
    arm = arm or load_robot(reference)[0]
    only_one_arm(arm, "set-ups of init", "write dataset.yaml as docs/two_arms.md has it")
    builtin = described and reference in builtin_robots()
    room = Room.of(arm)
    draft = Draft(
        name=name or folder.resolve().name, robot=reference if builtin else ROBOT,
        units=arm.units if described else ("deg",) * JOINTS,
        outlines={each: ARTEFACTS[each].outline(room) for each in artefacts}, tool_centre=tool,
        example=Sizes.of(arm).tool, placed=described,
    )  # fmt: skip
    columns, chosen = columns_of(draft), [ARTEFACTS[each] for each in artefacts]
    practice = "" if arm.masses is not None else " --effects geometry"  # without masses nothing bends
    context = {"columns": columns, "meaning": COLUMNS, "on_sphere": ON_SPHERE, "practice": practice}
    files = {
        SETTINGS: settings_text(draft),
        TABLE: ",".join(chain(*columns.values())) + "\n",
        README: rendered("README.md.j2", folder=folder.name, draft=draft, artefacts=chosen, **context),
        ".dataset.schema.json": schema_text("dataset"),
    }
    if not builtin:
        line = f"yaml-language-server: $schema={SCHEMA_OF_ROBOT}\n{arm.name}, from {Path(reference).name}"
        new = rendered("robot.yaml.j2", joints=JOINTS, models=robot_schema)  # no value is assumed
        files[ROBOT] = robot_to_yaml(arm, line) if described else new
        files[SCHEMA_OF_ROBOT] = schema_text("robot")
    return tuple(file for file in filled(folder, files) if not file.startswith("."))
