"""Effects that belong to a session: of several sessions fitted together, each has its own parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.vocabulary import Circumstances, Form, Parameter, Session


def alone(c: Circumstances, session: Session) -> Circumstances:
    """The circumstances of one session: still N rows, but only its own rows are fitted and vary."""
    temperature = c.temperature
    if temperature is not None and np.any(session.rows):
        temperature = np.where(session.rows, temperature, temperature[np.argmax(session.rows)])
    fitted = c.fitted[session.rows[c.fitted]]
    return replace(c, sessions=(), fitted=fitted, tied_base=session.tied_base, temperature=temperature)


def each(c: Circumstances) -> tuple[Circumstances, ...]:
    """The circumstances of every session that has rows to fit; of a single session, its own."""
    every = (alone(c, session) for session in c.sessions)
    return tuple(one for one in every if len(one.fitted)) if c.sessions else (c,)


def within(p: Parameter, session: Session) -> Parameter:
    """A parameter that acts in the rows of one session only; its name has the session as prefix."""
    terms = tuple(Term(t.frame, t.axis, np.where(session.rows, t.driver, 0.0)) for t in p.terms)
    return replace(p, name=f"{session.name}:{p.name}", terms=terms)


def apart(c: Circumstances, make: Callable[[Circumstances], list[Parameter]]) -> list[Parameter]:
    """Separate parameters for every session: those of `make` for its circumstances, in its rows."""
    if not c.sessions:
        return make(c)
    own = ((session, alone(c, session)) for session in c.sessions)
    return [within(p, session) for session, one in own if len(one.fitted) for p in make(one)]


def by_session(make: Callable[[Circumstances], list[Parameter]]) -> Form:
    """The form of an effect that belongs to a session: a base on its stand, a tool as it was mounted.

    Each session has its own parameters, at a site of its own. A single session has none in this form, which
    is then the usual one.
    """

    def own(c: Circumstances) -> list[Parameter]:
        return [
            replace(p, site=p.site.of(session.name))
            for session in c.sessions
            for p in apart(replace(c, sessions=(session,)), make)
        ]

    return Form("session", "in one session of several", own)
