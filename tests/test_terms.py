"""Texts use the terms of the field: a table of words and phrases that no text of the program may contain."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TERMS = {
    r"as drawn|the drawing": "nominal",
    r"kinematic \+ stiffness": "geometry + compliance",
    r"rungs?|ladder": "model level",
    r"held[- ]out|kept back|keeps back": "validation, cross-validation",
    r"told apart|tell apart|tells? .{1,40} from|cannot tell": "distinguish, distinguishable, identifiable",
    r"held to|holds? .{1,30} to (?:its|the) ": "checked against, validated against",
    r"papers?": "certificate",
    r"house|mend(?:s|ed)?|guilty|bump(?:s|ed)?|yields to|sick": "the technical term",
    r"worth trying|worth a word": "plausible, relevant",
    r"stands? out": "largest residual groups",
    r"to go on|goes on|go on": "Documentation; continues",
    r"nobody|thereof|wherein|whence|lest": "a plain sentence",
    r"had from": "obtained from",
    r"(?<!LR )mates?": "confusable effects",
    r"whole or not at all": "atomically",
    r"how sure|how surely": "uncertainty, probability",
    r"something else|something unknown|something more": "unmodelled effect outside the vocabulary",
    r"data decide|only the prior|data and prior": "identifiable, weakly identifiable, not identifiable",
    r"only as their sum": "only the combination is identifiable",
    r"worst": "maximum",
    r"play": "backlash, lost motion",
    r"errs?": "has an error",
    r"(?<!shop )floor": "expected RMS for a correct model",
    r"named from": "minimum detectable amplitude",
    r"puts on": "resulting error",
    r"one (?:can|could|would|may|might|must|has|wants|looks|knows|should|does)": "a sentence with a subject",
    r"truth apart|another maker": "ground truth, sealed; independent simulator",
    r"um|urad": "µm, µrad",
    r"workshops?": "shop floor",
    r"joints? yields?|its joints yield": "compliant joint",
    r"most important sentence": "delete it",
    r"what the model lacks": "unmodelled effects",
    r"what (?:it|they) (?:will )?buys?": "benefit, achieved uncertainty",
    r"needed of": "required for",
    r"if the model is right": "assuming the model is correct",
    r"free of collisions": "collision-free",
    r"mov(?:e|es|ed|ing) by hand": "jog manually",
    r"arm bent": "folded configuration",
    r"(?:targets|plan|poses) of validation": "validation targets",
    r"none of the known ones": "no known measurement",
    r"hangs? on the flange": "total mass attached to the flange",
    r"ball comes back|centre comes back": "nest that locates the ball centre repeatably",
    r"shall be": "must be",
    r"(?:is|are) square to|(?:are|faces are) square(?! root)": "perpendicular",
    r"stands? in braces": "enclosed in braces",
    r"which is said|it is said|no chance in it": "a message says so; deterministic",
    r"what comes with it": "not controlled",
    r"(?:the|its|their|another|of a|of the) makers?": "the manufacturer",
    r"what stands for what|motion that leads|but for": "except for",
    r"probabilities rest on|too decided": "assumptions; overconfident",
    r"only reason to believe|of 100 wrong": "the evidence for; 1 in 100 is wrong",
    r"is no site|states that the ball is": "is not treated as a site; places the ball",
    r"beside what is wanted|(?:not )?as wanted": "with target values; off target",
    r"machine as above": "as described above",
    r"each of joint": "in joints 1, 3 and 6",
    r"(?:outside|of|in) the vocabulary": "(not) in the list of known effects",
    r"beyond the axis|at the edge where|error until then": "off scale; clipped; if undetected",
    r"(?:errors )?have one sign": "have the same sign",
    r"negative by less": "estimate negative but within 2u of zero",
    r"kg beyond": "additional payload",
    r"masses in error|contains errors of": "uncertainty of masses",
    r"between certified centres": "between sphere centres",
    r"where the others put": "from the surface fitted to the other contacts",
    r"tool points?": "TCP",
}
"""What must not be written, as a regular expression of whole words, and what to write instead."""
PATTERN = re.compile(r"(?<![\w@./-])(?:" + "|".join(TERMS) + r")(?![\w/(]|\.\w|-\w)", re.IGNORECASE)

FOLDERS = ("analysis", "bayescal", "factors", "docs", "README.md", "CONTRIBUTING.md", "CHANGELOG.md")
NOT_YET: tuple[str, ...] = ()
"""Files and folders not covered yet; empty when all are."""


EXACT = {
    "um": "unit of a JSON value, by the output contract",
    "urad": "unit of a JSON value",
    "floor": "key of a record",
    "ladder": "key of gap.json, by the output contract",
    "worst_distance_um": "key of fit.json",
    "held out": "heading in the README of a session, not written by bayescal",
    "paper": "name of a random stream of simulated sessions",
}
"""String literals that are keys or units of the contract, and why."""


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Line number and text of everything a user or reader sees: Markdown, docstrings, comments, literals."""
    source = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        inside = False
        for k, line in enumerate(source.splitlines(), start=1):
            inside ^= line.lstrip().startswith("```")
            if not inside:
                yield k, re.sub(r"`[^`]*`", "", line)
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value not in EXACT:
            for k, line in enumerate(node.value.splitlines()):
                yield node.lineno + k, re.sub(r"`[^`]*`", "", line)
    for k, line in enumerate(source.splitlines(), start=1):
        if found := re.search(r"(?:^|\s)# (.*)", line):
            yield k, re.sub(r"`[^`]*`", "", found.group(1))


def files() -> list[Path]:
    """Every file that must use the terms."""
    out: list[Path] = []
    for name in FOLDERS:
        at = ROOT / name
        found = [at] if at.is_file() else [p for p in at.rglob("*") if p.suffix in (".py", ".md")]
        out += [p for p in found if not str(p.relative_to(ROOT)).startswith(NOT_YET or ("\0",))]
    return sorted(out)


@pytest.mark.parametrize("path", files(), ids=lambda p: str(p.relative_to(ROOT)))
def test_terms(path):
    found = [
        f"line {k}: '{m.group(0)}' in: {text.strip()}"
        for k, text in texts(path)
        for m in PATTERN.finditer(text)
    ]
    assert not found, "\n".join(found)
