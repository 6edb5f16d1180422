"""A benchmark that other calibration tools can enter: tasks, entries, score, page. See `docs/contest.md`."""
