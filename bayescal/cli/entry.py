"""A command as a process: what it prints and its exit code, if it is refused or stopped."""

import errno
import os
import signal
import sys
from collections.abc import Callable
from functools import cache

from bayescal.errors import BayescalError
from bayescal.storage.stopping import Stopped, leave, stoppable

FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))
"""A full disk, a limit on the size of files, an exhausted quota: no defect of ours."""


ORDER = (
    *("budget", "changed", "check", "compare", "compensate", "export", "fit", "fleet", "gap", "history"),
    *("import_", "init", "schema", "plan", "report", "robots", "simulate", "verify", "watch"),
)
"""Of the commands in the help, by function."""


@cache
def commands() -> Callable[[], object]:
    """The command with all its commands."""
    # these modules register them; what others describe "as of `fit`" stands in the first
    from bayescal.cli import evaluation, results, sessions  # noqa: F401
    from bayescal.cli.root import app

    app.registered_commands.sort(key=lambda command: ORDER.index(command.callback.__name__))  # type: ignore[union-attr]
    return app


def run(load: Callable[[], Callable[[], object]] = commands) -> None:
    """Run the command of this process; a `BayescalError` becomes one line and exit code 1.

    Parameters
    ----------
    load : callable
        Imports the commands, and returns what parses the arguments and calls one of them.
    """
    try:
        with stoppable():
            try:
                _command(load)
            finally:
                sys.stdout.flush()
    except OSError as error:
        if error.errno not in FULL:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Python writes the rest at its end
        where = str(error.filename or "output")
        sys.stderr.write(f"bayescal: {BayescalError(str(error.strerror), where, 'free some space')}\n")
        sys.exit(1)
    except BayescalError as error:
        sys.stderr.write(f"bayescal: {error}\n")
        sys.exit(1)
    except KeyboardInterrupt:
        leave(Stopped(signal.SIGINT))
    except Stopped as stopped:
        leave(stopped)


def _command(load: Callable[[], Callable[[], object]]) -> None:
    # the matrices are small: several BLAS threads would slow the computation down
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        os.getcwd()
    except OSError:
        raise BayescalError("it does not exist any more", "working directory", "change to another") from None
    load()()
