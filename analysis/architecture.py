"""The rooms of the code: their sizes, and the picture of their imports in docs/architecture.md.

    python -m analysis.architecture            prints files, code lines and imports by room
    python -m analysis.architecture --write    also draws docs/pictures/architecture.svg

Code lines are lines with code: neither docstrings nor comments nor blank lines.
"""

from __future__ import annotations

import argparse
import ast
import configparser
import io
import tokenize
from collections import Counter
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path
from xml.sax.saxutils import escape

import grimp

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs/pictures/architecture.svg"
PACKAGES = ("bayescal", "factors")
QUIET = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER
}  # fmt: skip
ROW, LEFT, WIDTH, BEND = 27, 150, 760, 16  # px: of the picture


@dataclass(frozen=True)
class Room:
    """A package or module directly in `bayescal`, or `factors`."""

    name: str
    files: int
    lines: int


def code_lines(source: str) -> int:
    """Number of lines of a Python source that hold code."""
    texts = {
        line
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    held = {k for t in tokens if t.type not in QUIET for k in range(t.start[0], t.end[0] + 1)}
    return len(held - texts)


def room_of(module: str) -> str:
    """The room of a module: `arm` of `bayescal.arm.chain`, `factors` of `factors.contacts`."""
    package, _, inside = module.partition(".")
    return inside.partition(".")[0] if package == "bayescal" and inside else package


def sizes(root: Path = ROOT) -> dict[str, Room]:
    """Every room with its files and code lines."""
    files, lines = Counter[str](), Counter[str]()
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            name = room_of(".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__"))
            files[name] += 1
            lines[name] += code_lines(path.read_text(encoding="utf-8"))
    return {name: Room(name, files[name], lines[name]) for name in files}


def arrows() -> Counter[tuple[str, str]]:
    """Number of importing modules by importing and imported room, also for imports inside functions."""
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True)
    pairs = {
        (module, room_of(imported))
        for module in graph.modules
        for imported in graph.find_modules_directly_imported_by(module)
    }
    out = Counter((room_of(module), room) for module, room in pairs)
    return Counter({pair: n for pair, n in out.items() if pair[0] != pair[1] and "bayescal" not in pair})


def layers() -> list[list[str]]:
    """Rooms by layer, the top first, as the contract `floors` of `.importlinter` states them."""
    config = configparser.ConfigParser()
    config.read(ROOT / ".importlinter")
    rows = config["importlinter:contract:floors"]["layers"].split("\n")
    return [[name.strip() for name in row.replace("|", ":").split(":")] for row in rows if row.strip()]


def reduced(pairs: Counter[tuple[str, str]]) -> set[tuple[str, str]]:
    """Imports that no chain of other imports contains: the picture shows these alone."""
    below: dict[str, set[str]] = {}
    for a, b in pairs:
        below.setdefault(a, set()).add(b)

    @cache
    def reach(room: str) -> set[str]:
        return {deeper for b in below.get(room, ()) for deeper in (b, *reach(b))}

    return {(a, b) for a, b in pairs if not any(b in reach(other) for other in below[a] - {b})}


def picture(rooms: dict[str, Room], pairs: Counter[tuple[str, str]]) -> str:
    """SVG of the rooms from top to bottom, each arrow to a room that it imports."""
    order = [name for row in layers() for name in row] + ["factors"]
    y = {name: ROW * (k + 1) for k, name in enumerate(order)}
    largest = max(r.lines for r in rooms.values())
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {ROW * (len(order) + 1)}" role="img" '
        'font-family="sans-serif" font-size="13"><title>Rooms of bayescal and their imports</title>'
    ]
    for a, b in sorted(reduced(pairs), key=lambda pair: (y[pair[0]], y[pair[1]])):
        x = LEFT + 200 + BEND * min(y[b] - y[a], 16 * ROW) / ROW
        out.append(
            f'<path class="{a} {b}" '
            f'd="M{LEFT + 130} {y[a]} C{x:.0f} {y[a]} {x:.0f} {y[b]} {LEFT + 134} {y[b]}" '
            'fill="none" stroke="#4878a8" stroke-opacity=".65"/>'
            f'<path d="M{LEFT + 132} {y[b]} l9 -4 v8 z" fill="#4878a8"/>'
        )
    for name in order:
        room = rooms[name]
        width = 120 * room.lines / largest
        out.append(
            f'<rect x="{LEFT}" y="{y[name] - 8}" width="{width:.1f}" height="16" fill="#c9d9e8"/>'
            f'<text x="{LEFT - 8}" y="{y[name] + 4}" text-anchor="end">{escape(name)}</text>'
            f'<text x="{LEFT + 4}" y="{y[name] + 4}" fill="#333">{room.lines}</text>'
        )
    return "\n".join((*out, "</svg>\n"))


def circles(pairs: Counter[tuple[str, str]]) -> list[tuple[str, str]]:
    """Pairs of rooms that import each other."""
    names = sorted({name for pair in pairs for name in pair})
    return [(a, b) for a, b in combinations(names, 2) if (a, b) in pairs and (b, a) in pairs]


def main() -> None:
    """Print the table, and write the picture if that is asked for."""
    parser = argparse.ArgumentParser(description="Rooms of the code, and their imports.")
    parser.add_argument("--write", action="store_true", help="write docs/pictures/architecture.svg")
    asked = parser.parse_args()
    rooms, pairs = sizes(), arrows()
    print(f"{'room':14} {'files':>5} {'lines':>6}  imports")
    for room in sorted(rooms.values(), key=lambda r: -r.lines):
        below = sorted(b for a, b in pairs if a == room.name)
        print(f"{room.name:14} {room.files:5} {room.lines:6}  {' '.join(below)}")
    total, files = sum(r.lines for r in rooms.values()), sum(r.files for r in rooms.values())
    print(f"{'all':14} {files:5} {total:6}  {len(pairs)} arrows, {len(circles(pairs))} both ways")
    if asked.write:
        PICTURE.write_text(picture(rooms, pairs), encoding="utf-8")


if __name__ == "__main__":
    main()
