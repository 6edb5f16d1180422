"""Interpreters of the subsets of FANUC TP, KUKA KRL and ABB RAPID that probing programs use.

Every statement must be one that is known here. Motions and latches are those of `probing_cell`: a FANUC skip
and a KUKA interrupt hold the joints of the control cycle of the trigger, an ABB search point too.
"""

from __future__ import annotations

import re

import numpy as np
from probing_cell import Cell, Stopped

DECELERATION = 1.0
"""m/s2 of stops of these controllers (assumed)."""
JOINT = 0.5
"""rad/s of their motions by joint angles (assumed)."""


def numbers(text: str) -> np.ndarray:
    """Six joints, rad, of a list such as `A1 10.0,A2 ...`, `J1= 10.0 deg, ...` or `[10.0,...]`."""
    found = re.findall(r"(?:[AJ]\d=?\s+)?(-?\d+\.\d+)(?: deg)?", text)
    assert len(found) == 6, text
    return np.radians([float(x) for x in found])


class Interpreter:
    """What all have: the cell, messages, and the hand that presses the probe where a program waits for it."""

    def __init__(self, cell: Cell):
        self.cell, self.messages, self.pauses, self.halted = cell, [], 0, False

    def wait(self, pressed: bool) -> None:
        """The person presses or releases the probe."""
        assert self.cell.pressed() != pressed, "a probe that was seen already"
        self.cell.by_hand = pressed

    def move(self, kind: str, goal: np.ndarray, speed: float, watch: bool = False) -> np.ndarray | None:
        """The readings at a trigger, or None."""
        return self.cell.run(kind, goal, JOINT if kind == "joint" else speed, watch, DECELERATION)


class Fanuc(Interpreter):
    """A program LS: numbered lines, positions in joints; `registers` PR by their number, deg."""

    def __init__(self, text: str, cell: Cell):
        super().__init__(cell)
        head, _, rest = text.partition("/MN\n")
        assert head.startswith("/PROG  BCPLAN")
        body, _, places = rest.partition("/POS\n")
        assert places.rstrip().endswith("/END")
        found = re.findall(r"P\[(\d+)\]\{\s+GP1:\s+UF : 0, UT : 1,\s+([^}]*)\};", places)
        self.points = {int(k): numbers(values) for k, values in found}
        lines = [re.fullmatch(r" *(\d+):  (.*) ;", line).groups() for line in body.splitlines()]
        assert [int(k) for k, _ in lines] == list(range(1, len(lines) + 1))
        self.lines = [line for _, line in lines]
        marks = ((k, re.fullmatch(r"LBL\[(\d+)\]", line)) for k, line in enumerate(self.lines))
        self.labels = {int(m[1]): k for k, m in marks if m}
        assert len(self.labels) == sum(line.startswith("LBL") for line in self.lines), "a label twice"
        self.registers: dict[int, np.ndarray] = {}
        self.r: dict[int, int] = {}
        self.armed = False

    def run(self) -> Fanuc:
        """Until the last line or ABORT."""
        at = 0
        while at < len(self.lines):
            line = self.lines[at]
            at += 1
            if line.startswith("!") or line.startswith("LBL[") or re.fullmatch(r"U(FRAME|TOOL)_NUM=\d", line):
                assert len(line) < 34, f"a remark too long: {line}"
            elif found := re.fullmatch(r"MESSAGE\[([^\];]{1,24})\]", line):
                self.messages.append(found[1])
            elif line == "PAUSE":
                self.pauses += 1
            elif line == "ABORT":
                self.halted = True
                return self
            elif found := re.fullmatch(r"WAIT DI\[1\]=(ON|OFF)", line):
                self.wait(found[1] == "ON")
            elif line == "SKIP CONDITION DI[1]=ON":
                self.armed = True
            elif found := re.fullmatch(r"JMP LBL\[(\d+)\]", line):
                at = self.labels[int(found[1])]
            elif found := re.fullmatch(r"IF DI\[1\]=ON,JMP LBL\[(\d+)\]", line):
                at = self.labels[int(found[1])] if self.cell.pressed() else at
            elif found := re.fullmatch(r"IF R\[1\]<=(\d+),JMP LBL\[(\d+)\]", line):
                at = self.labels[int(found[2])] if self.r[1] <= int(found[1]) else at
            elif found := re.fullmatch(r"R\[1\]=(\d+|R\[1\]\+1)", line):
                self.r[1] = self.r[1] + 1 if "R" in found[1] else int(found[1])
            elif found := re.fullmatch(r"PR\[(R\[1\]|\d+)(,1)?\]=(JPOS|\d+)", line):
                k = self.r[1] if "R" in found[1] else int(found[1])
                if found[2]:
                    self.registers[k][0] = float(found[3])
                else:
                    self.registers[k] = np.degrees(self.cell.q)
            else:
                at = self._motion(line, at)
        return self

    def _motion(self, line: str, at: int) -> int:
        skip = r"(?: Skip,LBL\[(\d+)\](?:,PR\[(\d+)\]=JPOS)?)?"
        found = re.fullmatch(rf"([JL]) P\[(\d+)\] (\d+)(%|mm/sec) FINE{skip}", line)
        assert found, line
        assert (found[1] == "J") == (found[4] == "%")
        assert self.armed or not found[5], "no condition for a skip"
        kind = "joint" if found[1] == "J" else "line"
        seen = self.move(kind, self.points[int(found[2])], 1e-3 * int(found[3]), bool(found[5]))
        if found[5] and seen is None:  # the skip jumps where its condition was not met
            return self.labels[int(found[5])]
        if found[6]:
            self.registers[int(found[6])] = np.degrees(seen)
        return at

    @property
    def listing(self) -> str:
        """POSREG.VA as a controller saves it."""
        out = ["[*POSREG*]$POSREG  Storage: CMOS  Access: RW  : ARRAY[1,100] OF Position Reg"]
        for k, q in sorted(self.registers.items()):
            joints = [f"J{j + 1} = {x:12.5f} deg" for j, x in enumerate(q)]
            out += [f"     [1,{k}] =   ''   Group: 1"]
            out += [f"  {'   '.join(joints[i : i + 3])}" for i in (0, 3)]
        return "\n".join(out) + "\n"


class Kuka(Interpreter):
    """A module of SRC and DAT; `variables` are those of the data list, deg."""

    def __init__(self, source: str, data: str, cell: Cell):
        super().__init__(cell)
        self.variables: dict = {}
        first, *lines, last = data.splitlines()
        assert (first, last) == ("DEFDAT bcplan", "ENDDAT")
        for line in lines:
            kind, name, value = re.fullmatch(r"DECL (E6AXIS|E6POS|BOOL|INT) (\w+)=(.*)", line).groups()
            assert len(name) <= 24
            assert name not in self.variables
            self.variables[name] = np.degrees(numbers(value)) if kind == "E6AXIS" else value
        self.routines = {}
        for name, parameters, body in re.findall(r"^DEF (\w+)\(([^\n]*)\)\n(.*?)^END$", source, re.M | re.S):
            lines = [line for line in body.splitlines() if not line.startswith((";", "DECL ")) and line]
            self.routines[name] = ([p.strip().split(":") for p in parameters.split(",") if p.strip()], lines)
        self.interrupt: tuple | None = None
        self.on = False

    def run(self) -> Kuka:
        """Until RETURN or END of the first routine."""
        self._call("bcplan", {})
        return self

    class Resumed(Exception):
        def __init__(self, level):
            self.level = level

    def _call(self, name: str, scope: dict) -> None:
        level = object()
        lines, at = self.routines[name][1], 0
        while at < len(lines):
            line = lines[at]
            at += 1
            if found := re.fullmatch(r"IF (.*) THEN", line):
                if not self._true(found[1], scope):
                    at = self._behind(lines, at)
            elif line == "ELSE":
                at = self._behind(lines, at)
            elif line == "ENDIF":
                pass
            elif line == "RETURN":
                self.halted = name == "bcplan"
                return
            elif found := re.fullmatch(r"INTERRUPT DECL 10 WHEN (.*) DO bctouch\(\)", line):
                self.interrupt = (found[1], level)
            elif found := re.fullmatch(r"(bc\w+)\((.*)\)", line):
                given = [text.strip() for text in found[2].split(",")]
                parameters = self.routines[found[1]][0]
                own = {p[0]: self._value(text, scope) for p, text in zip(parameters, given, strict=True)}
                try:
                    self._call(found[1], own)
                except Kuka.Resumed as resumed:
                    if resumed.level is not level:
                        raise
                for (parameter, mode), text in zip(parameters, given, strict=True):
                    if mode == "OUT":
                        self.variables[text] = own[parameter]
            else:
                self._statement(line, scope)

    def _behind(self, lines, at):
        depth = 1
        while depth:
            depth += (
                lines[at].startswith("IF ") - (lines[at] == "ENDIF") - (depth == 1 and lines[at] == "ELSE")
            )
            at += 1
        return at

    def _statement(self, line: str, scope: dict) -> None:
        if re.fullmatch(
            r"BAS\(#INITMOV,0\)|\$BASE=\$NULLFRAME|\$ADVANCE=0|WAIT SEC 0|\$VEL_AXIS\[\d\]=20", line
        ):
            pass
        elif found := re.fullmatch(r"(MsgNotify|MsgQuit)\(\"([^\"]*)\"\)", line):
            self.messages.append(found[2])
        elif line == "HALT":
            self.pauses += 1
        elif found := re.fullmatch(r"WAIT FOR \$IN\[1\]==(TRUE|FALSE)", line):
            self.wait(found[1] == "TRUE")
        elif line in ("INTERRUPT ON 10", "INTERRUPT OFF 10"):
            self.on = " ON " in line
        elif found := re.fullmatch(r"(PTP|LIN) (\w+)", line):
            assert scope is not None
            goal = np.radians(self._value(found[2], scope))
            kind = "joint" if found[1] == "PTP" else "line"
            seen = self.move(kind, goal, float(self.variables["$VEL.CP"]) if kind == "line" else 0.0, self.on)
            if seen is not None:
                self.variables["$AXIS_INT"] = np.degrees(seen)
                isr = self.routines["bctouch"][1]
                assert isr[-2:] == ["BRAKE F", "RESUME"]
                for each in isr[:-2]:
                    self._statement(each, {})
                raise Kuka.Resumed(self.interrupt[1])
        elif found := re.fullmatch(r"(\w+)\.A1=(\d+)", line):
            self.variables[found[1]] = self.variables[found[1]].copy()
            self.variables[found[1]][0] = float(found[2])
        else:
            found = re.fullmatch(r"(\$?[\w.]+)=(.+)", line)
            assert found, f"not known: {line}"
            name, value = found.groups()
            target = scope if name in scope else self.variables
            assert name in target or name == "$VEL.CP", f"not declared: {name}"
            target[name] = self._value(value, scope)

    def _value(self, text: str, scope: dict):
        if found := re.fullmatch(r"FORWARD\((\w+), BCERR\)", text):
            return self._value(found[1], scope)  # the pose of these axes; the cell moves lines by axes
        if text == "$AXIS_ACT":
            return np.degrees(self.cell.q)
        if text in ("TRUE", "FALSE") or re.fullmatch(r"[\d.]+", text):
            return text
        return scope[text] if text in scope else self.variables[text]

    def _true(self, text: str, scope: dict) -> bool:
        if text.startswith("$IN[1]"):
            return self.cell.pressed() == text.endswith("TRUE")
        name, _, value = text.partition("==")
        return self._value(name, scope) == (value or "TRUE")

    @property
    def data(self) -> str:
        """The data list as it is saved."""
        lines = ["&ACCESS RVP", "DEFDAT bcplan"]
        for name, q in self.variables.items():
            if isinstance(q, np.ndarray) and name.isalnum():
                axes = ",".join(f"A{k + 1} {x:.6f}" for k, x in enumerate(q))
                lines.append(f"DECL E6AXIS {name}={{{axes},E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}}")
        return "\n".join([*lines, "ENDDAT"]) + "\n"


class Abb(Interpreter):
    """A module of procedures; `log` is the file that it writes."""

    def __init__(self, text: str, cell: Cell):
        super().__init__(cell)
        lines = [line for line in text.splitlines() if line and not line.startswith("!")]
        assert (lines[0], lines[-1]) == ("MODULE bcplan", "ENDMODULE")
        self.values: dict = {"bcState": 0.0, "bcAt": None}
        self.speeds = dict(re.findall(r"CONST speeddata (\w+):=\[(\d+),", text))
        self.procedures = {}
        for name, parameters, body in re.findall(
            r"^PROC (\w+)\(([^\n]*)\)\n(.*?)^ENDPROC$", text, re.M | re.S
        ):
            main, _, handler = body.partition("ERROR\n")
            own = [line for line in main.splitlines() if line and not line.startswith(("!", "VAR "))]
            names = [p.split()[-1] for p in parameters.split(", ") if p]
            self.procedures[name] = (names, own, handler.splitlines())
        self.log = ""

    def run(self) -> Abb:
        """Until main ends, or EXIT."""
        try:
            self._block(self.procedures["main"][1], {})
        except Stopped:
            self.halted = True
        return self

    class Error(Exception):
        pass

    def _call(self, name: str, given: list[str], scope: dict) -> None:
        parameters, body, handler = self.procedures[name]
        own = {p: self._value(text, scope) for p, text in zip(parameters, given, strict=True)}
        try:
            self._block(body, own)
        except Abb.Error as error:
            own["ERRNO"] = str(error)
            self._block(handler, own)

    def _block(self, lines: list[str], scope: dict) -> None:
        at, skip, done = 0, 0, []
        while at < len(lines):
            line = lines[at]
            at += 1
            if found := re.fullmatch(r"(IF|ELSEIF) (.*) THEN", line):
                if found[1] == "IF":
                    done.append(False)
                true = not done[-1] and not skip and self._true(found[2], scope)
                if not true:
                    while lines[at] != "ENDIF" and not lines[at].startswith("ELSEIF"):
                        at += 1
                done[-1] = done[-1] or true
            elif line == "ENDIF":
                done.pop()
            elif line == "RETURN;":
                return
            else:
                assert line.endswith(";"), line
                self._statement(line[:-1], scope)

    def _true(self, text: str, scope: dict) -> bool:
        name, value = text.split("=")
        return str(self._value(name, scope)) == str(self._value(value, scope))

    def _statement(self, line: str, scope: dict) -> None:
        if found := re.fullmatch(r"TPWrite (.*)", line):
            self.messages.append(self._text(found[1], scope))
        elif line == "Stop":
            self.pauses += 1
        elif line == "EXIT":
            raise Stopped
        elif found := re.fullmatch(r"WaitDI diProbe,([01])", line):
            self.wait(found[1] == "1")
        elif found := re.fullmatch(r"MoveAbsJ (.*)\\NoEOffs,v100,fine,bcTool", line):
            self.move("joint", self._value(found[1], scope), 0.0)
        elif found := re.fullmatch(r"MoveL CalcRobT\((\w+),bcTool\),(\w+),fine,bcTool", line):
            self.move("line", self._value(found[1], scope), self._speed(found[2], scope))
        elif found := re.fullmatch(
            r"SearchL\\Stop,diProbe,found,CalcRobT\((\w+),bcTool\),(\w+),bcTool", line
        ):
            if self.cell.pressed():
                raise Abb.Error("ERR_SIGSUPSEARCH")
            seen = self.move("line", self._value(found[1], scope), self._speed(found[2], scope), watch=True)
            if seen is None:
                raise Abb.Error("ERR_WHLSEARCH")
            self.values["found"] = seen
        elif found := re.fullmatch(r"(bc\w+):=(.*)", line):
            assert found[1] in self.values
            self.values[found[1]] = self._value(found[2], scope)
        elif line.startswith("Open "):
            assert line == 'Open "HOME:"\\File:="bayescal.log",bcLog\\Append'
        elif found := re.fullmatch(r"Write bcLog,(.*?)(\\NoNewLine)?", line):
            text = self._text(found[1], scope)
            assert len(text) <= 80, "a string is too long"
            self.log += text + ("" if found[2] else "\n")
        elif line == "Close bcLog":
            pass
        else:
            name, _, rest = line.partition(" ")
            self._call(name, re.findall(r"\[\[.*?\],\[.*?\]\]|[^,]+", rest), scope)

    def _speed(self, name: str, scope: dict) -> float:
        return 1e-3 * float(self.speeds[str(scope.get(name, name))])

    def _text(self, expression: str, scope: dict) -> str:
        out = ""
        for part in re.findall(r'"[^"]*"|NumToStr\([^)]*\)|\w+', expression):
            if part.startswith('"'):
                out += part[1:-1]
            elif found := re.fullmatch(r"NumToStr\((\w+)(?:\.robax\.rax_(\d))?,(\d)\)", part):
                value = self._value(found[1], scope)
                value = value if found[2] is None else np.degrees(value[int(found[2]) - 1])
                out += f"{float(value):.{found[3]}f}"
            else:
                out += str(scope[part])
        return out

    def _value(self, text: str, scope: dict):
        if text in scope:
            return scope[text]
        if text in self.values:
            return self.values[text]
        if text == "CJointT()":
            return self.cell.q.copy()
        if text == "CalcJointT(found,bcTool)":
            return self.values["found"]
        if text.startswith("[["):
            joints, rest = re.fullmatch(r"\[(\[.*?\]),(\[.*?\])\]", text).groups()
            assert rest == "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
            return numbers(joints)
        return text[1:-1] if text.startswith('"') else text
