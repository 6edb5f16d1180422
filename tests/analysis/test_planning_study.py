"""The study of plans in small: the errors of simulated sessions are as large as the plan expects."""

from collections.abc import Iterator

import pytest

from analysis.planning import page, run, session

SMALL = 300


@pytest.fixture(scope="module", autouse=True)
def little() -> Iterator[None]:
    """One placement of the spheres."""
    session.ground.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "PLACEMENTS", 1)
        yield
    session.ground.cache_clear()


def test_measured_errors_are_as_expected():
    records = [run.simulated((SMALL, session.CHOSEN, 80, seed)) for seed in range(30, 54)]
    # errors of one session have one or two degrees of freedom: most of all the length of the arm
    assert all(0.65 < ratio < 1.5 for ratio in page.ratios(records))
    wrong = [r | {"u_um": [2.5 * u for u in r["u_um"]]} for r in records]
    assert not any(0.65 < ratio < 1.5 for ratio in page.ratios(wrong))


def test_command(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "SIZES", ((60, 120),))
    monkeypatch.setattr(run, "SELECTIONS", ((session.CHOSEN, 80), (session.RANDOM, 120)))
    target = tmp_path / "page.md"
    target.write_text(f"before\n{page.BEGIN}\nold\n{page.END}\nafter\n", encoding="utf-8")
    arguments = ["--sessions", "2", "--candidates", str(SMALL), "--out", str(tmp_path), "--page", str(target)]
    run.main(arguments)
    first = capsys.readouterr().out
    assert "| 60 |" in first
    assert "| 120 random | 1 |" in first
    text = target.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert "old" not in text
    assert first.strip() in text
    run.main(arguments)  # all is stored
    assert capsys.readouterr().out == first
