"""Programs of every format, with positions and much that looks like one."""

from cases import DATA

KINDS = ("ls", "src", "mod", "script", "csv")
FANUC, KUKA, ABB, URSCRIPT, ROBODK = ((DATA / "programs" / f"weld.{kind}").read_bytes() for kind in KINDS)
