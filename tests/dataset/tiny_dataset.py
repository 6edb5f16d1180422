"""A tiny valid dataset with every kind of target, to be spoilt one line at a time."""

from pathlib import Path

from cases import file_text

SETTINGS = file_text("tiny/dataset.yaml")
TABLE = file_text("tiny/measurements.csv")
HEADER = TABLE.partition("\n")[0]


def line_of(text: str, part: str) -> int:
    """Line of the first occurrence of `part`."""
    return text[: text.index(part)].count("\n") + 1


def write(folder: Path, settings: str = SETTINGS, table: str = TABLE) -> Path:
    (folder / "dataset.yaml").write_text(settings, encoding="utf-8")
    (folder / "measurements.csv").write_text(table, encoding="utf-8")
    return folder
