"""Damage to files: bytes, cells, columns, keys, structure, and plausible wrong values."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from analysis.fuzz.markup import MARKUP, WORKBOOK, record_entry

Files = dict[str, bytes]
Rng = np.random.Generator

NASTY = (
    "", " ", "nan", "inf", "-inf", "1e308", "-1e308", "1e400", "1e-320", "0", "-0", "-1", "1e9",
    "-1e-9", "1,5", "1_000", "0x10", "1e", "--1", "12°", "١٢", "１２", "½", "1 2", "None", "true", "~",
    "null", "!FILL_IN", "[]", "{}", "[1, 2", "*a", "&a x", "a: b", "#", "|", ">", "'", '"', "`x`",
    "../../etc/passwd", "/dev/zero", "http://x", "file.xacro", "x" * 300, "y" * 30_000, "\x1b[31mred",
    "a\x00b", "\u202eabc", "é", "\ufeff", "\u2028", "😀", "%s%n", "{0}", "{x}", "$(id)",
    "99999999999999999999999", "2026-01-01", "12:00:00", "=1+1", "j1_deg", "calibrate",
)  # fmt: skip
"""Values of any cell, key or number."""
NUMBER = re.compile(rb"(?<![\w.])-?\d+\.?\d*(?:e-?\d+)?(?![\w.])")
WORD = re.compile(rb"[A-Za-z_][\w.+@-]*")
FACTORS = (1e-3, 1e3, np.pi / 180, 180 / np.pi, 25.4, 1 / 25.4, 10.0, -1.0, 2.0, 0.5, 1e6, 1e-6)


def pick(rng: Rng, values):
    """One of a sequence."""
    return values[int(rng.integers(len(values)))]


def nasty(rng: Rng) -> bytes:
    return pick(rng, NASTY).encode()


def _spot(rng: Rng, text: bytes, longest: int = 40) -> slice:
    start = int(rng.integers(len(text) + 1))
    return slice(start, start + int(rng.integers(longest)))


def _put(text: bytes, where: slice, new: bytes) -> bytes:
    return text[: where.start] + new + text[where.stop :]


def _token(pattern: re.Pattern[bytes]) -> Callable[[bytes, Rng], bytes]:
    """Replace one match of a pattern: by something nasty, or by another match."""

    def change(text: bytes, rng: Rng) -> bytes:
        found = list(pattern.finditer(text))
        if not found:
            return text
        at = pick(rng, found)
        new = nasty(rng) if rng.random() < 0.6 else pick(rng, found)[0]
        return text[: at.start()] + new + text[at.end() :]

    return change


def _lines(change: Callable[[list[bytes], Rng], list[bytes]]) -> Callable[[bytes, Rng], bytes]:
    return lambda text, rng: b"\n".join(change(text.split(b"\n"), rng))


def _removed(lines: list[bytes], rng: Rng) -> list[bytes]:
    del lines[int(rng.integers(len(lines)))]
    return lines


def _twice(lines: list[bytes], rng: Rng) -> list[bytes]:
    at = int(rng.integers(len(lines)))
    return [*lines[: at + 1], *[lines[at]] * int(rng.integers(1, 4)), *lines[at + 1 :]]


def _swapped(lines: list[bytes], rng: Rng) -> list[bytes]:
    a, b = rng.integers(len(lines), size=2)
    lines[a], lines[b] = lines[b], lines[a]
    return lines


def _scaled(text: bytes, rng: Rng) -> bytes:
    found = list(NUMBER.finditer(text))
    if not found:
        return text
    at = pick(rng, found)
    new = b"%r" % (float(at[0]) * pick(rng, FACTORS))
    return text[: at.start()] + new + text[at.end() :]


TEXT: dict[str, Callable[[bytes, Rng], bytes]] = {
    "bytes": lambda t, rng: _put(t, _spot(rng, t, 8), rng.bytes(int(rng.integers(8)))),
    "cut": lambda t, rng: _put(t, _spot(rng, t, 400), b""),
    "truncate": lambda t, rng: t[: int(rng.integers(len(t) + 1))],
    "insert": lambda t, rng: _put(t, slice(s := int(rng.integers(len(t) + 1)), s), nasty(rng)),
    "number": _token(NUMBER),
    "word": _token(WORD),
    "scale": _scaled,
    "line removed": _lines(_removed),
    "line twice": _lines(_twice),
    "lines swapped": _lines(_swapped),
    "line indented": _lines(lambda lines, rng: [b"  " * (rng.random() < 0.03) + x for x in lines]),
    "empty": lambda t, rng: b"",
    "mark": lambda t, rng: b"\xef\xbb\xbf" * int(rng.integers(1, 3)) + t,
    "crlf": lambda t, rng: t.replace(b"\n", pick(rng, (b"\r\n", b"\r", b"\n\n"))),
    "encoding": lambda t, rng: t.decode("utf-8", "replace").encode(pick(rng, ("utf-16", "utf-7")), "replace"),
    "digits": lambda t, rng: t.replace(b"1", "１".encode()),
    "repeated": lambda t, rng: t * int(rng.integers(2, 30)),
    "nested": lambda t, rng: t + b"\nx: " + pick(rng, (b"[", b"{a: ", b"- ")) * int(rng.integers(2, 3000)),
}  # fmt: skip


def table_of(text: bytes) -> list[list[str]]:
    return [line.split(",") for line in text.decode("utf-8", "replace").strip().split("\n")]


def text_of(rows: list[list[str]]) -> bytes:
    return ("\n".join(",".join(row) for row in rows) + "\n").encode()


def _cells(change: Callable[[list[list[str]], int, int, Rng], None]) -> Callable[[bytes, Rng], bytes]:
    """A change of a table, given a random row (below the header) and column."""

    def run(text: bytes, rng: Rng) -> bytes:
        rows = table_of(text)
        width = min(map(len, rows))
        if len(rows) > 1:
            change(rows, int(rng.integers(1, len(rows))), int(rng.integers(width)), rng)
        return text_of(rows)

    return run


def _cell(rows, i, j, rng):
    rows[i][j] = pick(rng, NASTY)


def _column(rows, i, j, rng):
    value = pick(rng, NASTY) if rng.random() < 0.5 else rows[i][j]
    for row in rows[1:]:
        row[j] = value


def _column_scaled(rows, i, j, rng):
    factor = pick(rng, FACTORS)
    for row in rows[1:]:
        with contextlib.suppress(ValueError):
            row[j] = repr(float(row[j]) * factor)


def _column_removed(rows, i, j, rng):
    for row in rows:
        del row[j]


def _column_twice(rows, i, j, rng):
    for row in rows:
        row.append(row[j])


def _column_renamed(rows, i, j, rng):
    rows[0][j] = pick(rng, (*NASTY, rows[0][j].upper(), rows[0][j].partition("_")[0], rows[0][j] + "_mm"))


def _columns_swapped(rows, i, j, rng):
    other = int(rng.integers(min(map(len, rows))))
    for row in rows[int(rng.integers(2)) :]:
        row[j], row[other] = row[other], row[j]


def _rows_copied(rows, i, j, rng):
    for _ in range(int(rng.integers(1, 5))):
        copy = list(rows[i])
        copy[0] += "" if rng.random() < 0.3 else f"copy{rng.integers(999)}"
        rows.insert(int(rng.integers(1, len(rows) + 1)), copy)


def _rows_shuffled(rows, i, j, rng):
    rows[1:] = [rows[1:][k] for k in rng.permutation(len(rows) - 1)]


def _rows_few(rows, i, j, rng):
    del rows[1 + int(rng.integers(6)) :]


def _row_short(rows, i, j, rng):
    del rows[i][j:]


def _rows_alike(rows, i, j, rng):
    for row in rows[1:]:
        row[1:] = rows[i][1:]


CELLS = {
    f.__name__.lstrip("_").replace("_", " "): _cells(f)
    for f in (
        _cell, _column, _column_scaled, _column_removed, _column_twice, _column_renamed, _columns_swapped,
        _rows_copied, _rows_shuffled, _rows_few, _row_short, _rows_alike,
    )
}  # fmt: skip

ENTRY = re.compile(rb"[\w.@+-]+: ?(?:\[[^\]]*\]|\{[^}]*\}|[^,{}\[\]\n]+)")


def _entry(text: bytes, rng: Rng) -> bytes:
    """Remove, double, rename or refill an entry of a YAML mapping."""
    found = list(ENTRY.finditer(text))
    if not found:
        return text
    at = pick(rng, found)
    key, _, value = at[0].partition(b":")
    new = pick(rng, (
        b"", at[0] + b", " + at[0], nasty(rng) + b":" + value, key + b": " + nasty(rng), key + b":",
        key.rpartition(b"_")[0] + b":" + value, key + b"_rad:" + value, key + b": [" + value + b"]",
        key + b": {" + at[0] + b"}", key + b": &a " + value, pick(rng, found)[0],
    ))  # fmt: skip
    return text[: at.start()] + new + text[at.end() :]


Damage = Callable[[Path, Rng], None]


def _some(folder: Path, rng: Rng) -> Path:
    return pick(rng, sorted(p for p in folder.rglob("*") if p.is_file()))


def _replaced(make: Callable[[Path], None]) -> Damage:
    def change(folder: Path, rng: Rng) -> None:
        path = _some(folder, rng)
        path.unlink()
        make(path)

    return change


STRUCTURE: dict[str, Damage] = {
    "missing": _replaced(lambda path: None),
    "folder": _replaced(lambda path: path.mkdir()),
    "pipe": _replaced(os.mkfifo),
    "device": _replaced(lambda path: path.symlink_to("/dev/zero")),
    "loop": _replaced(lambda path: path.symlink_to(path)),
    "dangling": _replaced(lambda path: path.symlink_to("nowhere")),
    "away": _replaced(lambda path: path.symlink_to("/etc/passwd")),
    "unreadable": lambda folder, rng: _some(folder, rng).chmod(0),
}


def _columns(text: bytes, pattern: str, change: Callable[[float], float]) -> bytes:
    rows = table_of(text)
    at = [j for j, name in enumerate(rows[0]) if re.fullmatch(pattern, name)]
    for row in rows[1:]:
        for j in at:
            row[j] = repr(change(float(row[j]))) if row[j] else ""
    return text_of(rows)


def _swap(text: bytes, a: str, b: str) -> bytes:
    rows = table_of(text)
    if a in rows[0] and b in rows[0]:
        i, j = rows[0].index(a), rows[0].index(b)
        for row in rows[1:]:
            row[i], row[j] = row[j], row[i]
    return text_of(rows)


def _keys(text: bytes, pattern: str, factor: float) -> bytes:
    """Every number behind keys that match, times a factor."""

    def scaled(found: re.Match[bytes]) -> bytes:
        return found[1] + NUMBER.sub(lambda n: b"%r" % (float(n[0]) * factor), found[2])

    return re.sub(rf"(\b(?:{pattern}): )(\[[^\]]*\]|[^,}}\n]+)".encode(), scaled, text)


def _table(change: Callable[[bytes], bytes]) -> Callable[[Files], Files]:
    return lambda files: files | {"measurements.csv": change(files["measurements.csv"])}


def _yaml(pattern: str, factor: float) -> Callable[[Files], Files]:
    return lambda files: files | {"dataset.yaml": _keys(files["dataset.yaml"], pattern, factor)}


def _robot(pattern: str, factor: float) -> Callable[[Files], Files]:
    return lambda files: (
        files | ({"robot.yaml": _keys(files["robot.yaml"], pattern, factor)} if "robot.yaml" in files else {})
    )


PLAUSIBLE: dict[str, Callable[[Files], Files]] = {
    "points in m": _table(lambda t: _columns(t, "[xyz]_mm", lambda v: v / 1e3)),
    "points in inches": _table(lambda t: _columns(t, "[xyz]_mm", lambda v: v / 25.4)),
    "points mirrored": _table(lambda t: _columns(t, "x_mm", lambda v: -v)),
    "points swapped": _table(lambda t: _swap(t, "x_mm", "y_mm")),
    "joints in rad": _table(lambda t: _columns(t, r"j\d_deg", lambda v: v * np.pi / 180)),
    "joints in deg twice": _table(lambda t: _columns(t, r"j\d_deg", lambda v: v * 180 / np.pi)),
    "one joint in rad": _table(lambda t: _columns(t, "j2_deg", lambda v: v * np.pi / 180)),
    **{f"sign of j{k}": _table(lambda t, k=k: _columns(t, f"j{k}_deg", lambda v: -v)) for k in range(1, 7)},
    "joints swapped": _table(lambda t: _swap(t, "j2_deg", "j3_deg")),
    "wrist swapped": _table(lambda t: _swap(t, "j4_deg", "j6_deg")),
    "joint off by 90": _table(lambda t: _columns(t, "j3_deg", lambda v: v + 90)),
    "velocities in rad": _table(lambda t: _columns(t, r"j\d_degps", lambda v: v * np.pi / 180)),
    "orientation in rad": _table(lambda t: _columns(t, "r[xyz]_deg", lambda v: v * np.pi / 180)),
    "torque sign": _table(lambda t: _columns(t, r"j\d_nm", lambda v: -v)),
    "time in ms": _table(lambda t: _columns(t, "time_s", lambda v: v * 1e3)),
    "temperature in F": _table(lambda t: _columns(t, "temperature_c", lambda v: v * 1.8 + 32)),
    "payload in g": _table(lambda t: _columns(t, "payload_kg", lambda v: v * 1e3)),
    "length in m": _table(lambda t: _columns(t, "length_mm", lambda v: v / 1e3)),
    "certificate in inches": _yaml("distance_mm", 1 / 25.4),
    "certificate x 25.4": _yaml("distance_mm", 25.4),
    "certificate x 1000": _yaml("distance_mm", 1e3),
    "certificate in m": _yaml("distance_mm", 1e-3),
    "certificate 15 % off": _yaml("distance_mm", 1.15),
    "certificate 1 % off": _yaml("distance_mm", 1.01),
    "u of certificate in µm": _yaml("u_distance_mm", 1e3),
    "u of certificate in m": _yaml("u_distance_mm", 1e-3),
    "u of angle in deg": _yaml("u_angle_rad", 180 / np.pi),
    "diameter for radius": _yaml("ball_radius_mm", 2.0),
    "ball in m": _yaml("ball_radius_mm", 1e-3),
    "sphere in inches": _yaml("diameter_mm", 1 / 25.4),
    "tool in m": _yaml("centre_mm", 1e-3),
    "tool mirrored": _yaml("centre_mm", -1.0),
    "normals inwards": _yaml("normal", -1.0),
    "offsets in m": _yaml("offset_mm", 1e-3),
    "instrument in m": _yaml("xyz_mm", 1e-3),
    "instrument in rad": _yaml("rpy_deg", np.pi / 180),
    "noise in µm": _yaml("contact_mm|point_mm", 1e3),
    "noise in m": _yaml("contact_mm|point_mm", 1e-3),
    "mass in g": _yaml("mass_kg", 1e3),
    "gravity upwards": _yaml("gravity_mps2", -1.0),
    "gravity in g": _yaml("gravity_mps2", 1 / 9.81),
    "robot in m": _robot("a_mm|d_mm", 1e-3),
    "robot in inches": _robot("a_mm|d_mm", 1 / 25.4),
    "robot alpha sign": _robot("alpha_deg", -1.0),
    "robot offset in rad": _robot("offset_deg", np.pi / 180),
    "robot masses in g": _robot("mass_kg", 1e3),
}


OF_KIND: dict[tuple[str, ...], dict[str, Callable[[bytes, Rng], bytes]]] = {
    (".csv",): {**CELLS, **{f"{k} ": v for k, v in CELLS.items()}},
    (".yaml", ".map"): {f"entry {k}": _entry for k in range(12)},
    (".json",): {f"entry {k}": record_entry for k in range(24)},
    (".urdf", ".xacro", ".xml"): MARKUP,
    (".xlsx",): WORKBOOK,
}
"""Changes beyond those of any text, by the suffix of the file."""


def damaged(files: Files, rng: Rng) -> tuple[Files, list[str]]:
    """Files with one to three changes of their text, and the names of the changes."""
    out, names = dict(files), []
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        file = pick(rng, sorted(out))
        changes = dict(TEXT)
        for suffixes, more in OF_KIND.items():
            changes |= more if file.endswith(suffixes) else {}
        name = pick(rng, sorted(changes))
        out[file] = changes[name](out[file], rng)
        names.append(f"{file}: {name.strip()}")
    return out, names
