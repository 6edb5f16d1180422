"""Programs of every format, with positions and much that looks like one."""

from cases import DATA

FANUC, KUKA, ABB, URSCRIPT, ROBODK = (
    (DATA / "programs" / f"weld.{kind}").read_bytes() for kind in ("ls", "src", "mod", "script", "csv")
)
