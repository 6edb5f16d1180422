"""Real sessions compared with `bayescal changed`: parts whose difference is known, and halves that have none.

- sockets: of a Panda, a ball in the first and the second socket of every place (50 mm apart), as one target;
- runs: of the Motoman, two runs over the same planes; the wall moved by 0.8 mm in between;
- faces: of the Motoman, two faces of its tool (up to 1 mm off a common centre), as one tool;
- halves: of every session, poses at random.

``python -m analysis.real_changes --real ../shared/data/real --out docs/real_changes.md``
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from analysis.pages import published
from analysis.pages import table as markdown
from analysis.real_halves import modelled
from analysis.records import Record, completed, real_arguments, real_folders
from bayescal.changes import changed
from bayescal.dataset import Dataset, read_dataset
from bayescal.dataset.write import taken
from bayescal.estimate.families import poses
from bayescal.model.scene import Scene

MARKS = ("<!-- changes: begin -->", "<!-- changes: end -->")
RANDOM = 2
SOCKETS, WALL = (".0", ".1"), ("wall@1", "wall@2")
FACES = ("face0", "face1")
"""Tools that are one in the comparison of faces; the others are in both parts."""
Pair = tuple[Dataset, Dataset]


class Task(NamedTuple):
    """A comparison of two parts of a session."""

    folder: Path
    what: str

    @property
    def key(self) -> str:
        """Of its record."""
        return f"{self.folder.name} | {self.what}"


def part(d: Dataset, kept: np.ndarray, name: str) -> Dataset:
    """Some rows of a session, as a session with a name."""
    rows = taken(d.measurements, np.flatnonzero(kept))
    return replace(d, name=name, sha256=name, measurements=rows)


def sockets(d: Dataset) -> Pair:
    """The first and the second socket of every place, under the name and the stated place of the first."""
    of_row = np.array([t.name for t in d.targets])[d.measurements.target]
    first = {t.name.removesuffix(SOCKETS[0]): t for t in d.targets if t.name.endswith(SOCKETS[0])}
    out = []
    for end in SOCKETS:
        own = part(d, np.char.endswith(of_row, end), f"socket{end}")
        names = [t.name.removesuffix(end) for t in d.targets if t.name.endswith(end)]
        at = {f"{name}{end}": k for k, name in enumerate(names)}
        index = np.array([at.get(t.name, 0) for t in d.targets])
        targets = tuple(replace(first[name], name=name) for name in names)
        m = replace(own.measurements, target=index[own.measurements.target])
        out.append(replace(own, targets=targets, certificates=(), measurements=m))
    return out[0], out[1]


def runs(d: Dataset) -> Pair:
    """Two runs over the same planes: the second time that a contact is repeated is of the second."""
    m = d.measurements
    of_row = np.array([t.name for t in d.targets])[m.target]
    label = np.array([""] * len(m.ids)) if m.repeat is None else m.repeat.astype(str)
    seen: set[tuple[str, str]] = set()
    second = np.zeros(len(m.ids), bool)
    for k, (name, of) in enumerate(zip(label, of_row, strict=True)):
        second[k] = of == WALL[1] or bool(name and (name, of) in seen)
        seen.add((name, of))
    one = [t for t in d.targets if t.name != WALL[1]]
    targets = tuple(replace(t, name="wall") if t.name == WALL[0] else t for t in one)
    index = np.array([0 if t.name in WALL else [x.name for x in targets].index(t.name) for t in d.targets])
    plain = replace(d, targets=targets, measurements=replace(m, target=index[m.target]))
    plain = replace(plain, measurements=replace(plain.measurements, role=np.full(len(m.ids), "calibrate")))
    touched = np.array([t.kind == "plane" for t in d.targets])[m.target]
    return part(plain, ~second & touched, "run 1"), part(plain, second & touched, "run 2")


def faces(d: Dataset) -> Pair:
    """Contacts with two faces of the tool as those of one face, with half of those of the other faces."""
    m = d.measurements
    name = np.array([t.name for t in d.tools])[m.tool]
    half = np.arange(len(m.ids)) // 8 % 2 == 0
    index = np.array(
        [[t.name for t in d.tools].index(FACES[0]) if t.name in FACES else k for k, t in enumerate(d.tools)]
    )
    touched = np.array([t.kind == "plane" for t in d.targets])[m.target]
    plain = replace(d, measurements=replace(m, tool=index[m.tool]))
    others = touched & ~np.isin(name, FACES)
    first, second = (
        (others & own) | (touched & (name == face)) for own, face in zip((half, ~half), FACES, strict=True)
    )
    return part(plain, first, FACES[0]), part(plain, second, FACES[1])


def halves(d: Dataset, seed: int) -> Pair:
    """Halves of the poses at random."""
    pose = poses(d.measurements, np.arange(len(d.measurements.ids)))
    order = np.random.default_rng(seed).permutation(int(pose.max()) + 1)
    one = np.isin(pose, order[: len(order) // 2])
    return part(d, one, "half 1"), part(d, ~one, "half 2")


PARTS: dict[str, Callable[[Dataset], Pair]] = {"sockets": sockets, "runs": runs, "faces": faces} | {
    f"halves {k}": lambda d, k=k: halves(d, k)  # type: ignore[misc]
    for k in range(1, RANDOM + 1)
}
OF = {"sockets": "panda", "runs": "motoman", "faces": "motoman"}
"""Sessions of a comparison, by the beginning of their names; of others all."""


def made(task: Task) -> Record:
    """The record of a comparison."""
    pair = PARTS[task.what](read_dataset(task.folder))
    found = changed(pair, modelled(Scene(pair[0])))
    named = {d.item.name: " or ".join(d.group) or d.item.name for d in found.differences if d.stated}
    return {
        "session": task.folder.name, "what": task.what, "verdict": found.verdict, "arm": found.arm,
        "same": found.same, "arm_same": found.arm_same, "named": list(dict.fromkeys(named.values())),
    }  # fmt: skip


def tasks(real: Path, sessions: Sequence[str] = ()) -> Iterator[Task]:
    """All comparisons."""
    for folder in real_folders(real, sessions):
        for what in PARTS:
            if folder.name.startswith(OF.get(what, "")):
                yield Task(folder, what)


def table(records: Sequence[Record]) -> str:
    """The page's table, as Markdown."""
    rows = (
        (r["session"], r["what"], r["verdict"], r["arm"], f"{r['arm_same']:.2f}", "; ".join(r["named"]))
        for r in records
    )
    return markdown(("session", "parts", "verdict", "arm", "P(arm same)", "changed"), rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the records that are missing, and write the table of all."""
    given = real_arguments("real_changes", __doc__).parse_args(arguments)
    every = {t.key: t for t in tasks(given.real, given.sessions)}
    found = completed(given.runs / "records.json", every, made, given.workers, "comparisons")
    published(table(found), given.out, MARKS, new=True)


if __name__ == "__main__":  # worker processes import this module too
    main()
