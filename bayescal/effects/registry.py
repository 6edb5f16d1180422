"""The vocabulary as a table: the effects of this package, of other installed packages, and of a user.

Another package provides effects as entry points of the group `GROUP`. They are read once, at the first use of
the table. A program adds its own effects with `register`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points

from bayescal.effects.vocabulary import Effect
from bayescal.errors import BayescalError

GROUP = "bayescal.effects"
"""Group of the entry points; each one names an `Effect`."""
NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
"""Permitted names of effects: options separate names by commas, settings by @, sites by blanks."""


class Vocabulary(Mapping[str, Effect]):
    """Effects by name, in the order in which they were added.

    Parameters
    ----------
    listed : iterable of Effect
        The effects of the package.
    reserved : iterable of str
        Names that no further effect may have: they have another meaning in files and options.
    """

    def __init__(self, listed: Iterable[Effect], reserved: Iterable[str] = ()) -> None:
        listed = tuple(listed)
        self._effects = {effect.name: effect for effect in listed}
        assert len(self._effects) == len(listed), "two effects of one name"
        self._own = frozenset(self._effects)
        self._reserved = frozenset(reserved)
        self._complete = False

    def __getitem__(self, name: str) -> Effect:
        self._read_entry_points()
        return self._effects[name]

    def __iter__(self) -> Iterator[str]:
        self._read_entry_points()
        return iter(tuple(self._effects))

    def __len__(self) -> int:
        self._read_entry_points()
        return len(self._effects)

    def register(self, effect: Effect) -> None:
        """Add an effect: models may then name it, and the diagnosis tries it.

        Parameters
        ----------
        effect : Effect

        Raises
        ------
        BayescalError
            If the argument is not an effect, if its name is in use or not permitted on a command line, or if
            its fields name effects that do not exist.
        """
        self._read_entry_points()
        self._add(effect, "effects.register")
        try:
            self._check_names(effect, "effects.register")
        except BayescalError:
            del self._effects[effect.name]
            raise

    def unregister(self, name: str) -> None:
        """Remove a registered effect, so that another effect can be registered under its name.

        Raises
        ------
        BayescalError
            For an effect of the package, or one that is not registered.
        """
        if name in self._own or name not in self:
            names = ", ".join(n for n in self if n not in self._own) or "none"
            raise BayescalError(f"`{name}` was not registered", "effects.unregister", f"registered: {names}")
        del self._effects[name]

    def _add(self, effect: object, where: str) -> None:
        if not isinstance(effect, Effect):
            what = f"{type(effect).__name__} is not an Effect"
            raise BayescalError(what, where, "give a bayescal.effects.Effect")
        if not NAME.fullmatch(effect.name):
            remedy = "use small letters, digits and hyphens, for example cable-drag"
            raise BayescalError(f"`{effect.name}` cannot name an effect", where, remedy)
        if effect.name in self._effects or effect.name in self._reserved:
            raise BayescalError(f"the name `{effect.name}` is in use", where, "give the effect another name")
        self._effects[effect.name] = effect

    def _check_names(self, effect: Effect, where: str) -> None:
        for field in ("confusable_with", "requires", "part_of"):
            for other in getattr(effect, field):
                if other == effect.name or other not in self._effects:
                    what = f"{field} of {effect.name} names `{other}`, which is not another effect"
                    raise BayescalError(what, where, f"known: {', '.join(self._effects)}")

    def _read_entry_points(self) -> None:
        if self._complete:
            return
        self._complete = True  # at once: a package that is loaded here may read the vocabulary
        before = dict(self._effects)
        try:
            loaded = [(_loaded(entry), _place(entry)) for entry in entry_points(group=GROUP)]
            for effect, where in loaded:
                self._add(effect, where)
            for effect, where in loaded:
                assert isinstance(effect, Effect)
                self._check_names(effect, where)
        except BaseException:
            self._effects, self._complete = before, False
            raise


def _place(entry: EntryPoint) -> str:
    package = f" of {entry.dist.name}" if entry.dist is not None else ""
    return f"entry point {entry.name} = {entry.value}{package}"


def _loaded(entry: EntryPoint) -> object:
    try:
        return entry.load()
    except BayescalError:
        raise
    except Exception as error:
        what = f"cannot be loaded: {type(error).__name__}: {error}"
        raise BayescalError(what, _place(entry), "correct or uninstall that package") from error
