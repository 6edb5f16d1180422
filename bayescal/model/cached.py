"""Quantities of a scene that are computed once: for all poses of its arm, and for rows that another has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from bayescal.arm.statics import Stance
from bayescal.dataset import Dataset
from bayescal.dataset.write import taken

if TYPE_CHECKING:
    from bayescal.model.scene import Scene

T = TypeVar("T")


class unposed(cached_property[T]):
    """A cached quantity that scenes of one dataset share at all poses of an arm; see `Scene.posed_at`."""

    def __get__(self, scene: Any, owner: Any = None) -> T:  # type: ignore[override]
        """The quantity of the scene from which this one was posed."""
        return super().__get__(scene if scene is None or scene.origin is None else scene.origin, owner)


class rowwise(cached_property[T]):
    """A cached quantity of single rows: of a continued scene, that of the rows before and of the new ones."""

    def __get__(self, scene: Any, owner: Any = None) -> T:  # type: ignore[override]
        """The quantity of all rows."""
        scene = scene if scene is None or scene.origin is None or self.posed else scene.origin
        name = self.attrname
        if scene is None or scene.parts is None or name is None or name in vars(scene):
            return super().__get__(scene, owner)
        vars(scene)[name] = stacked([getattr(part, name) for part in scene.parts])
        return super().__get__(scene, owner)

    posed = False


class posed_rowwise(rowwise[T]):
    """The same of a quantity that depends on the pose of the arm."""

    posed = True


def stacked(parts: list[Any]) -> Any:
    """Arrays one below the other, or dataclasses of such arrays; None where there are none."""
    first = parts[0]
    if first is None:
        return None
    if is_dataclass(first):
        each = {f.name: stacked([getattr(part, f.name) for part in parts]) for f in fields(first)}
        return replace(first, **each)  # type: ignore[type-var]
    return np.concatenate(parts)


def continued(scene: Scene, dataset: Dataset, stance: Callable[[Scene], Stance]) -> Scene:
    """The scene of a session with further rows: what single rows determine is computed for these alone.

    Parameters
    ----------
    scene : Scene
        Of the rows before, which cannot be continued again.
    dataset : Dataset
        Its first rows are those of the scene, in all columns but the role.
    stance : callable
        Where the arm stands in the further rows, from their scene; where it stands in the others is kept.
    """
    before, m = len(scene.dataset.measurements.ids), dataset.measurements
    rows = np.arange(before, len(m.ids))
    later = replace(scene, dataset=replace(dataset, measurements=taken(m, rows)), stance=None)
    there = scene.stance
    if there is not None:
        later = replace(later, stance=stance(later))
        there = stacked([there, later.stance])
    out = replace(scene, dataset=dataset, stance=there)
    object.__setattr__(scene, "parts", None)  # what it has from the rows before it is computed by now
    object.__setattr__(out, "parts", (scene, later))
    return out
