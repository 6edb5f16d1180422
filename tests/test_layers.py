"""Imports go down only, as `.importlinter` says: its contracts hold, and each of them sees a wrong import."""

from copy import deepcopy

import grimp
import pytest
from cases import ROOT, cases
from importlinter.api import read_configuration
from importlinter.contracts.forbidden import ForbiddenContract
from importlinter.contracts.layers import LayersContract

CONFIGURATION = read_configuration(str(ROOT / ".importlinter"))
SESSION = CONFIGURATION["session_options"]
KINDS = {"layers": LayersContract, "forbidden": ForbiddenContract}
OPTIONS = CONFIGURATION["contracts_options"]
CONTRACTS = {of["id"]: KINDS[of["type"]](of["name"], SESSION, of) for of in OPTIONS}
BREACHES = cases("layer_breaches")
"""An import that is not there, and the contract that forbids it."""


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph(
        *SESSION["root_packages"],
        include_external_packages=SESSION["include_external_packages"] == "True",
        exclude_type_checking_imports=SESSION["exclude_type_checking_imports"] == "True",
        cache_dir=None,
    )


def kept(contract, graph) -> bool:
    return CONTRACTS[contract].check(deepcopy(graph), verbose=False).kept


@pytest.mark.parametrize("contract", CONTRACTS)
def test_contracts_are_kept(graph, contract):
    assert kept(contract, graph)


@pytest.mark.parametrize(("importer", "imported", "contract"), BREACHES)
def test_a_breach_is_seen(graph, importer, imported, contract):
    spoilt = deepcopy(graph)
    assert imported in spoilt.modules or imported.split(".")[0] not in SESSION["root_packages"]
    spoilt.add_import(importer=importer, imported=imported)
    assert not kept(contract, spoilt)


def test_every_contract_has_a_breach():
    assert {contract for *_, contract in BREACHES} == CONTRACTS.keys()
