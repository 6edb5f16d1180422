"""`plan.html`: a plan as a page of one file. Names come from files of the user: the template escapes them."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

from bayescal import __version__
from bayescal.planning.result import Plan
from bayescal.reporting.plan import phrases, sheets

TEMPLATE = "page.html.j2"


def plan_page(plan: Plan, picture: bytes, commands: Sequence[str] = ()) -> str:
    """The page as text.

    Parameters
    ----------
    plan : Plan
    picture : bytes
        The figure as PNG.
    commands : sequence of str
        What to run when the contacts are measured.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(TEMPLATE).render(
        name=plan.session.name,
        robot=plan.session.robot.name,
        title=phrases.title(plan),
        headline=list(phrases.headline(plan)),
        further=phrases.further(plan),
        contacts=phrases.contacts(plan),
        travel=phrases.travel(plan),
        candidates=phrases.candidates(plan),
        detectability=phrases.detectability(plan),
        not_separated=phrases.not_separated(plan),
        expected=sheets.expected(plan),
        by_target=sheets.by_target(plan),
        detectable=sheets.detectable(plan, every_site=True),
        confusable=sheets.confusable(plan),
        parameters=sheets.parameters(plan),
        observability=sheets.observability(plan),
        rows=sheets.contacts(plan),
        warnings=plan.warnings,
        picture=base64.b64encode(picture).decode("ascii"),
        commands=commands,
        version=__version__,
        sha256=plan.pool.setup.dataset.sha256 or "-",
        seed=plan.seed,
        seconds=phrases.duration(plan.seconds),
    )
