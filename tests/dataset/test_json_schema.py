"""JSON schemas and the page of the format: current, and in agreement with what the reader accepts."""

import json
import re

import foreign
import jsonschema
import pytest
import yaml
from cases import ROOT, cases, refused
from tiny_dataset import SETTINGS

import bayescal as bc
from bayescal.dataset import schema, session, solids
from bayescal.dataset.schema import CERTIFICATES, entry_of
from bayescal.dataset.table import COLUMNS, JOINT, PLAIN
from bayescal.dataset.target_kinds import KINDS
from bayescal.preparing.artefacts import MODELS, UNITS, schema_text
from bayescal.robots import schema as of_robots
from bayescal.storage.files import stem_of

ROBOTS = sorted((ROOT / "bayescal" / "robots").glob("*.yaml"))
CHECKED = (
    schema.DatasetFile, schema.ToolEntry, schema.HeldEntry, schema.NoiseEntry, schema.Loose,
    *map(entry_of, KINDS.values()),
    *CERTIFICATES.values(), schema.PlanEntry, schema.VolumeEntry, schema.RegionEntry,
    schema.RecordEntry, schema.SerialsEntry, session.ArtefactFile, session.PointEntry,
    solids.BoxEntry, solids.CylinderEntry, solids.MeshEntry,
    of_robots.RobotFile, of_robots.Joint, of_robots.Link, of_robots.Place, of_robots.GroundEntry,
)  # fmt: skip


def plain(value):
    """YAML 1.2 numbers of texts, as an editor reads them: PyYAML takes 1e-5 for a text."""
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, list):
        return [plain(v) for v in value]
    if re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", value, re.IGNORECASE):
        return float(value)
    return value


def load(text: str):
    return plain(yaml.load(text, Loader=yaml.BaseLoader))


@pytest.fixture(scope="module")
def valid():
    """Whether a file is valid by its schema."""
    validators = {name: jsonschema.Draft202012Validator(bc.schema(name)) for name in MODELS}
    return lambda name, content: not [e.message for e in validators[name].iter_errors(content)]


@pytest.mark.parametrize("name", MODELS)
def test_the_stored_schema_is_current(name):
    stored = ROOT / "docs" / "schema" / f"{name}.schema.json"
    assert stored.read_text(encoding="utf-8") == schema_text(name), f"bayescal schema {name} > {stored.name}"
    jsonschema.Draft202012Validator.check_schema(json.loads(schema_text(name)))


def test_there_is_no_other_schema():
    refused("no schema `urdf`", lambda: bc.schema("urdf"))


@pytest.mark.parametrize("path", ROBOTS, ids=lambda p: p.stem)
def test_built_in_robots_are_valid(path, valid):
    assert valid("robot", load(path.read_text(encoding="utf-8")))


def test_datasets_are_valid(valid):
    assert valid("dataset", load(SETTINGS))
    assert valid("dataset", load((ROOT / "data" / "lrmate200ic-cube" / "dataset.yaml").read_text()))


@foreign.needs()
def test_shared_datasets_are_valid(valid):
    found = [*foreign.DATA.glob("real/*/dataset.yaml"), *foreign.DATA.glob("worlds-dev*/*0/dataset.yaml")]
    assert found
    assert [str(path) for path in found if not valid("dataset", load(path.read_text(encoding="utf-8")))] == []
    robots = [p.with_name("robot.yaml") for p in found if p.with_name("robot.yaml").is_file()]
    assert [str(path) for path in robots if not valid("robot", load(path.read_text(encoding="utf-8")))] == []


@pytest.mark.parametrize(("old", "new"), cases("schema_refusals"))
def test_what_the_reader_refuses_is_not_valid(old, new, valid):
    assert old in SETTINGS
    assert not valid("dataset", load(SETTINGS.replace(old, new)))


def test_every_key_has_a_description_with_its_unit():
    for name in MODELS:
        found = bc.schema(name)
        for part in (found, *found["$defs"].values()):
            for key, entry in part["properties"].items():
                assert key == "kind" or len(entry["description"]) > 8, key
                if unit := stem_of(key)[1]:
                    assert entry["description"].endswith(f"Unit: {UNITS.get(unit, unit)}."), key


def test_the_page_states_every_key_and_column(valid):
    page = (ROOT / "docs" / "dataset.md").read_text(encoding="utf-8")
    for model in CHECKED:
        for name, field in model.model_fields.items():
            key = field.alias or name
            if key == "kind":
                continue
            unit = stem_of(key)[1]
            need = " **Needed.**" if field.is_required() else ""
            row = f"| `{key}` | {UNITS.get(unit, unit)} | {field.description}{need} |"
            assert row in page, f"{model.__name__}: {row}"
    for column, meaning in COLUMNS.items():
        assert f"| `{column}` | {meaning} |" in page
    # examples of the page are valid
    examples = (load(text) for text in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL))
    of_dataset, of_artefact, of_solids, of_plan, of_record, of_robot = examples
    assert valid("dataset", of_dataset)
    assert valid("dataset", of_dataset | of_solids | of_plan | of_record)
    assert valid("artefact", of_artefact)
    assert valid("robot", of_robot)


def test_every_column_is_explained():
    assert set(COLUMNS) == {*PLAIN, *(f"jN_{kind}" for kind in (*JOINT, *JOINT.values()))}
