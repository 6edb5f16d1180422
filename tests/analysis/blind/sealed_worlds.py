"""Blind folders without diagnoses: worlds and answers are made up, seals are not."""

from analysis.blind import make as maker
from analysis.blind import run as runner
from analysis.blind import seal
from analysis.blind.folder import FILES


def made_up(task):
    """A world of a seed and number, as `make.built` returns one."""
    seed, number = task.seed, task.number
    texts = {name: f"{name} of world {number} of seed {seed}\n" for name in FILES}
    return texts, {"world": f"{number:03d}", "effects": ["step"], "seed": seed}


def guessed(task):
    """An answer, as `run.answered` returns one; world 001 crashes."""
    about = {"world": task.name, "dataset_sha256": seal.of_world(task.texts), "code_sha256": seal.of_code()}
    said = {"error": "no arm"} if task.name == "001" else {"gap": {"verdict": "named", "effects": ["step"]}}
    return about | {"seconds": 1.5} | said


def here(monkeypatch, most: int | None = None) -> list:
    """Have worlds made up and answers guessed in this process; Ctrl-C comes after `most` results.

    Returns
    -------
    list
        The tasks that are done, as they are.
    """
    done = []

    def results_of(work):
        def results(_, tasks, workers, dask):
            for k, task in enumerate(tasks):
                if k == most:
                    raise KeyboardInterrupt
                done.append(task)
                yield k, work(task)

        return results

    monkeypatch.setattr(maker, "results", results_of(made_up))
    monkeypatch.setattr(runner, "results", results_of(guessed))
    return done
