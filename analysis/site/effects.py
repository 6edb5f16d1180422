"""A page for each effect, from its docstring: formula, driver, prior with source, remedy, signature."""

from __future__ import annotations

import ast
import inspect
import re
from collections import Counter
from functools import cache
from itertools import pairwise
from pathlib import Path

from analysis.site import signatures
from bayescal.effects import EFFECTS, UNITS, Effect, Parameter, vocabulary

FORMULA = re.compile(r"^Formula: \$`(.*?)`\$[;.]?\s*", re.MULTILINE)
SYMBOLS = (
    "ρ is a rotation and δ a displacement, of joint or frame k about or along the axis; n is the "
    "direction of contact; q is a joint angle. [The model](../model.md) states the frames."
)

PAGE = """# {name}

{summary}.

{text}

{symbols}

## In a session

Parameters in a session of an LR Mate 200iC on four faces of a cube{setting}:

| parameter | number | site | driver | prior standard deviation |
| --- | --- | --- | --- | --- |
{parameters}

![Signature of {name}: error at the contacts]({name}.png)

The change of the residuals by one prior standard deviation of a parameter: of the leading site along its
coordinate, and its RMS for each parameter. Geometry, targets and compliance absorb a part of it in a fit; a
diagnosis counts what is left.

## On the shop floor

{remedy}

## In a model

{names}
"""

INDEX = """# Effects

The known effects. `--model` accepts every name, in `fit`, `gap` and `simulate --effects`; a diagnosis
may name each. The priors state what is plausible on small arms, with their source. [An effect of your
own](../contributing.md#an-effect) is one definition.

| effect | | not assessed if |
| --- | --- | --- |
{rows}
"""


@cache
def _docstrings() -> dict[str, str]:
    """The docstring below each definition in the modules of effects, by the name of its constant."""
    out = {}
    for file in Path(vocabulary.__file__).parent.glob("*.py"):
        for node, below in pairwise(ast.parse(file.read_text(encoding="utf-8")).body):
            match node, below:
                case ast.Assign([ast.Name(name)]), ast.Expr(ast.Constant(str(text))):
                    out[name] = inspect.cleandoc(text)
    return out


def docstring(effect: Effect) -> str:
    """The docstring below the definition of an effect."""
    return _docstrings()[effect.name.replace("-", "_").upper()]


def body(effect: Effect) -> str:
    """The text of an effect as Markdown, with its formula in a fence."""
    text = docstring(effect).partition("\n\n")[2]
    text = text.replace("``", "`")
    return FORMULA.sub(lambda m: f"```math\n{m[1]}\n```\n\n", text, count=1)


def lead(effect: Effect) -> str:
    """The first sentence of an effect, after its name."""
    first = " ".join(docstring(effect).partition("\n\n")[0].split())
    text = first.partition(": ")[2] or first
    return text[0].upper() + text[1:].rstrip(".")


def _sd(p: Parameter) -> str:
    unit, factor = UNITS[p.unit]
    return f"{p.sd * factor:.2g} {unit.replace('urad', 'µrad').replace('um/', 'µm/')}".replace(" 1", "")


def table(parameters: tuple[Parameter, ...]) -> str:
    """Rows of parameters: those with the same kind of site and driver, unit and prior together."""
    count: Counter[tuple[str, str, str]] = Counter()
    first: dict[tuple[str, str, str], str] = {}
    for p in parameters:
        own = re.sub(r" of J\d+", " of the joint", p.driver.text)
        key = (p.site.kind, own, _sd(p))
        count[key] += 1
        first.setdefault(key, p.name)
    return "\n".join(
        f"| `{first[key]}`{' ...' if n > 1 else ''} | {n} | {key[0]} | {key[1]} | {key[2]} |"
        for key, n in count.items()
    )


def needs(effect: Effect) -> str:
    """What a session with joint readings alone lacks for an effect, or ""."""
    return effect.missing(signatures.bare())


def names(effect: Effect) -> str:
    """Names of an effect in a model, and its relations to other effects."""
    lines = [f"- `{effect.name}`: at all its sites; `{effect.name} at SITE`: at one"]
    if effect.scan is not None:
        lines.append(f"- `{effect.name}@VALUE`: {effect.scan.what}")
    lines += [f"- `{effect.name}@{form.name}`: {form.words}" for form in effect.forms]
    relations = (
        ("Confusable with", tuple(n for n in EFFECTS if _confusable(effect.name, n))),
        ("Acts through, and therefore requires", effect.requires),
        ("Has the same parameters as", effect.part_of),
    )
    for words, others in relations:
        if others:
            lines.append(f"- {words}: " + ", ".join(f"[{n}]({n}.md)" for n in others if n in EFFECTS))
    if lacks := needs(effect):
        lines.append(f"- Not assessed if: {lacks}")
    return "\n".join(lines)


def _confusable(name: str, other: str) -> bool:
    return other in EFFECTS[name].confusable_with or name in EFFECTS[other].confusable_with


def page(name: str) -> str:
    """The page of an effect."""
    effect = EFFECTS[name]
    setting = signatures.setting_of(effect)
    return PAGE.format(
        name=name,
        summary=lead(effect),
        text=body(effect),
        symbols=SYMBOLS,
        setting="" if setting is None else f" (`{name}@{setting:g}`)",
        parameters=table(signatures.signature(name).parameters),
        remedy=effect.remedy,
        names=names(effect),
    )


def index() -> str:
    """The list of all effects."""
    rows = [f"| [{n}]({n}.md) | {e.summary} | {needs(e)} |" for n, e in EFFECTS.items()]
    return INDEX.format(rows="\n".join(rows))


def texts() -> dict[str, str]:
    """Pages of all effects, by path."""
    return {"effects/index.md": index()} | {f"effects/{name}.md": page(name) for name in EFFECTS}


def pictures() -> dict[str, bytes]:
    """Pictures of all effects, by path."""
    return {f"effects/{name}.png": signatures.picture(name) for name in EFFECTS}
