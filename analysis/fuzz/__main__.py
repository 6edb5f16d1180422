"""`make fuzz`: cases in workers, each result written at once, and a table of the classes of failures.

    python -m analysis.fuzz --cases 10000 --seed 0 --workers 2 --out runs/fuzz
    python -m analysis.fuzz --replay 1234 --seed 0

An interrupted run continues where it stopped. A worker that dies or does not answer is replaced, and its case
counts as a failure.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

SILENT = 600.0
"""Seconds without a result after which a worker is replaced: compiled code does not see the alarm."""
MEMORY = 6 * 2**30


def main() -> None:
    """Run, resume or replay."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"))
    parser.add_argument("--replay", type=int, help="one case, whose files are kept")
    parser.add_argument("--worker", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.replay is not None:
        replay(options.replay, options.seed, options.out)
    elif options.worker is not None:
        work(options)
    else:
        sys.exit(supervise(options))


def replay(number: int, seed: int, out: Path) -> None:
    """One case again; its files stay in `out`/replay."""
    from analysis.fuzz.cases import as_json, case

    folder = out.resolve() / "replay"
    print(json.dumps(json.loads(as_json(case(number, seed, folder), number)), indent=1))
    print(f"files: {folder}/in")


def results(out: Path, seed: int) -> dict[int, dict[str, object]]:
    """What was recorded, by the number of the case; a begun case without a result has the kind ``begun``."""
    found: dict[int, dict[str, object]] = {}
    for path in sorted(out.glob(f"{seed}-*.jsonl")):
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                entry = json.loads(line)
            except ValueError:
                continue  # cut by a kill
            found[entry["number"]] = entry
    return found


def work(options: argparse.Namespace) -> None:
    """The cases of one worker, in order, without those that are done or killed an earlier worker."""
    import resource

    from analysis.fuzz.cases import as_json, case

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    done = results(options.out, options.seed)
    with (
        (options.out / f"{options.seed}-{options.worker}.jsonl").open("a", encoding="utf-8") as log,
        tempfile.TemporaryDirectory(prefix="bayescal-fuzz-") as folder,
    ):
        for number in range(options.worker, options.cases, options.workers):
            if number in done:
                continue
            log.write(
                json.dumps({"number": number, "kind": "begun", "why": "crash or hang of the process"}) + "\n"
            )
            log.flush()
            log.write(as_json(case(number, options.seed, Path(folder) / "case"), number) + "\n")
            log.flush()


def supervise(options: argparse.Namespace) -> int:
    """Start the workers, replace those that die or are silent, print the table."""
    options.out.mkdir(parents=True, exist_ok=True)
    for path in options.out.glob(f"{options.seed}-*.jsonl"):  # what an interrupt cut short runs again
        done = [
            line
            for line in path.read_text(encoding="utf-8").splitlines(True)
            if '"kind": "begun"' not in line
        ]
        path.write_text("".join(line for line in done if line.endswith("\n")), encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "analysis.fuzz",
        "--cases",
        options.cases,
        "--seed",
        options.seed,
        "--out",
        options.out,
    ]
    start = [*map(str, command), "--workers", str(options.workers), "--worker"]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # the workers end with this process
    running = {k: (subprocess.Popen([*start, str(k)]), time.time()) for k in range(options.workers)}
    try:
        while running:
            time.sleep(2.0)
            for k, (process, since) in list(running.items()):
                log = options.out / f"{options.seed}-{k}.jsonl"
                last = max(since, log.stat().st_mtime if log.exists() else since)
                if process.poll() is None and time.time() - last > SILENT:
                    process.kill()
                    process.wait()
                if process.poll() == 0:
                    del running[k]
                elif process.poll() is not None:
                    running[k] = (subprocess.Popen([*start, str(k)]), time.time())
    finally:
        for process, _ in running.values():
            process.terminate()
    return table(results(options.out, options.seed), options)


def table(found: dict[int, dict[str, object]], options: argparse.Namespace) -> int:
    """Print the counts and the classes of failures with the way to repeat them; 1 if there are any."""
    kinds = Counter(str(entry["kind"]) for entry in found.values())
    print(
        f"{len(found)} cases of seed {options.seed}: "
        + ", ".join(f"{n} {k}" for k, n in sorted(kinds.items()))
    )
    classes: dict[str, list[int]] = defaultdict(list)
    for number, entry in sorted(found.items()):
        if entry["kind"] in ("FAIL", "begun"):
            classes[re.sub(r"'.*|\d+(?=[^:\d].*)", "", str(entry["why"]))[:90]].append(number)
    for name, numbers in sorted(classes.items(), key=lambda item: -len(item[1])):
        print(f"{len(numbers):6}  {name}\n        {' '.join(map(str, numbers[:8]))}")
    if classes:
        print(f"replay: {sys.executable} -m analysis.fuzz --seed {options.seed} --replay NUMBER")
    return int(bool(classes))


if __name__ == "__main__":
    main()
