"""Imports go down only, as `.importlinter` says."""

import configparser
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("importlinter")
ROOT = Path(__file__).parents[1]


def lint(*options: str, root: Path = ROOT) -> subprocess.CompletedProcess[str]:
    program = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    command = [sys.executable, "-c", program, "--config", str(ROOT / ".importlinter"), "--no-cache", *options]
    paths = os.pathsep.join([str(root), *([] if root == ROOT else [str(ROOT)])])
    environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)


def test_contracts_are_kept():
    done = lint()
    assert done.returncode == 0, done.stdout + done.stderr
    config = configparser.ConfigParser()
    config.read(ROOT / ".importlinter")
    contracts = [section for section in config.sections() if section.startswith("importlinter:contract:")]
    assert f"Contracts: {len(contracts)} kept, 0 broken" in " ".join(done.stdout.split())


BREACHES = [
    ("bayescal/model/model.py", "", ""),  # none: the copy itself is sound
    ("bayescal/arm/chain.py", "from bayescal.errors import BayescalError\nimport bayescal.model", "floors"),
    ("bayescal/estimate/estimate.py", "def late():\n    import bayescal.cli", "floors"),
    ("bayescal/effects/tool.py", "from bayescal.dataset import Tool", "floors"),
    ("bayescal/nowhere.py", "", "floors"),
    ("factors/kind.py", "from bayescal.errors import BayescalError", "factors"),
    ("bayescal/arm/statics.py", "from factors.kind import dot", "arm"),
    ("bayescal/effects/geometry.py", "import gtsam", "arm"),
    ("bayescal/estimate/estimate.py", "import gtsam", "graph"),
    ("factors/plane.py", "import gtsam", "graph"),
    ("bayescal/model/model.py", "import arviz", "sampler"),
    ("bayescal/estimate/estimate.py", "def late():\n    import emcee.moves", "sampler"),
    ("bayescal/blind/workers.py", "def late():\n    import distributed", "dask"),
    ("bayescal/cli/evaluation.py", "def late():\n    from bayescal.calibration import fit", "commands"),
]


@pytest.mark.parametrize(("file", "text", "contract"), BREACHES)
def test_a_breach_is_seen(file, text, contract, tmp_path):
    """A copy of the sources with one wrong import more breaks the contract that forbids it, and only then."""
    for package in ("bayescal", "factors"):
        for source in (ROOT / package).rglob("*.py"):
            copy = tmp_path / source.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(source.read_bytes())
    with (tmp_path / file).open("a", encoding="utf-8") as spoilt:
        spoilt.write("\n" + text + "\n")
    done = lint(*(["--contract", contract] if contract else []), root=tmp_path)
    assert done.returncode == bool(contract), done.stdout + done.stderr
    assert f"{int(bool(contract))} broken" in done.stdout
