"""Expand one xacro file: a program that `bayescal.robots` starts in a process of its own.

Its argument is a JSON object: `file` (a name in the working directory), `path` (where modules are looked
for), `seconds` and `bytes` (the limits). It writes XML to the standard output, or one line of what is wrong
to the standard error. It knows nothing of the package.
"""

import json
import os
import sys


def limit(seconds: int, memory: int) -> None:
    """Limit processor time (s), memory and written files (bytes), where the OS can."""
    try:
        import resource
    except ImportError:  # Windows: the parent's timeout alone
        return
    wanted = {resource.RLIMIT_CPU: seconds, resource.RLIMIT_CORE: 0}
    wanted |= dict.fromkeys((resource.RLIMIT_AS, resource.RLIMIT_FSIZE), memory)
    for what, value in wanted.items():
        try:
            resource.setrlimit(what, (value, value))
        except (OSError, ValueError):  # macOS refuses some; a lower limit that is set already is kept
            continue


def main() -> None:
    """Read the argument, expand, write."""
    asked = json.loads(sys.argv[1])
    limit(asked["seconds"], asked["bytes"])
    sys.path[:] = asked["path"]
    import xacro
    from defusedxml import minidom

    def parse(_: object, filename: str) -> object:
        """The first file and every included one: regular, without DOCTYPE and entities."""
        if os.path.exists(filename) and not os.path.isfile(filename):
            raise OSError(f"{filename} is not a regular file")
        return minidom.parse(filename, forbid_dtd=True)

    xacro.parse = parse
    try:
        text = xacro.process_file(asked["file"], verbosity=0).toxml(encoding="utf-8")
    except Exception as error:  # a xacro file is a program: it fails in any way it likes
        cause = getattr(error, "exc", None) or error
        sys.exit(f"{type(cause).__name__}: {error}".replace("XacroException: ", "", 1))
    sys.stdout.buffer.write(text)


if __name__ == "__main__":
    main()
