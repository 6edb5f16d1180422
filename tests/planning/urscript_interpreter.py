"""An interpreter of the subset of URScript that probing programs use, on a simulated cell.

Blocks are parsed by lines; expressions of this subset have the grammar of Python's and are parsed by its
`ast`, then evaluated here. Threads are generators that give way at every control cycle.
"""

from __future__ import annotations

import ast
import operator
import re
from functools import cache

import numpy as np
from probing_cell import Cell, Stopped

OPERATORS = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.Gt: operator.gt,
    ast.LtE: operator.le, ast.GtE: operator.ge,
}  # fmt: skip
HEADS = {"def": r"def (\w+)\(([\w, ]*)\):", "thread": r"thread (\w+)\(()\):"}


class Return(Exception):
    def __init__(self, value):
        self.value = value


def parsed(text: str) -> list:
    """Nested blocks: (statement, body, [(elif or else, body), ...])."""
    lines = [line.split("#")[0].strip() if '"' not in line else line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line]
    block, at = _block(lines, 0)
    assert at == len(lines), f"`end` too much: {lines[at]}"
    return block


def _block(lines: list[str], at: int) -> tuple[list, int]:
    out = []
    while at < len(lines) and not re.match(r"(end|else:|elif .*:)$", lines[at]):
        line = lines[at]
        if re.match(r"(def|thread|if|while)\b", line):
            assert line.endswith(":"), line
            body, at = _block(lines, at + 1)
            others = []
            while at < len(lines) and lines[at] != "end":
                head = lines[at]
                own, at = _block(lines, at + 1)
                others.append((head, own))
            assert at < len(lines), f"no end of: {line}"
            out.append((line, body, others))
        else:
            out.append((line, [], []))
        at += 1
    return out, at


@cache
def _tree(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


class Program:
    """A program on a cell; `log` has the lines of textmsg, `popups` the messages to the person."""

    def __init__(self, text: str, cell: Cell, force: bool = False):
        (head, body, _), *rest = parsed(text)
        assert head == "def bayescal_plan():"
        assert not rest
        self.body, self.cell, self.force = body, cell, force
        self.globals: dict = {}
        self.functions: dict = {}
        self.threads: dict[int, object] = {}
        self.log, self.popups = [], []
        self.halted = False

    def run(self) -> Program:
        """Until the program ends, a control cycle at a time."""
        self.threads[0] = self._run(self.body, self.globals)
        while 0 in self.threads:
            for name in list(self.threads):
                if name not in self.threads:
                    continue
                try:
                    next(self.threads[name])
                except StopIteration:
                    self.threads.pop(name, None)
                except Stopped:
                    self.halted = True
                    return self
        return self

    def _run(self, block, scope):
        for line, body, others in block:
            yield from self._statement(line, body, others, scope)

    def _statement(self, line, body, others, scope):
        for kind, pattern in HEADS.items():
            if found := re.fullmatch(pattern, line):
                self.functions[found[1]] = (kind, [a.strip() for a in found[2].split(",") if a.strip()], body)
                return
        if line.startswith("if "):
            for head, own in [(line, body), *others]:
                test = head.partition(" ")[2].rstrip(":") if head != "else:" else "True"
                if (yield from self._value(test, scope)):
                    yield from self._run(own, scope)
                    return
        elif line.startswith("while "):
            test = line[6:].rstrip(":")
            while (yield from self._value(test, scope)):
                yield from self._run(body, scope)
        elif line == "halt":
            raise Stopped
        elif line.startswith("kill "):
            self.threads.pop(scope[line[5:]]).close()
        elif line.startswith("return "):
            raise Return((yield from self._value(line[7:], scope)))
        elif found := re.fullmatch(r"(global |local )?(\w+) = (.*)", line):
            target = self.globals if found[1] == "global " else scope
            assert found[1] or scope is not self.globals or found[2] in scope
            if call := re.fullmatch(r"run (\w+)\(\)", found[3]):
                kind, _, own = self.functions[call[1]]
                assert kind == "thread"
                target[found[2]] = max(self.threads) + 1
                self.threads[max(self.threads) + 1] = self._run(own, {})
            else:
                target[found[2]] = yield from self._value(found[3], scope)
        else:
            yield from self._value(line, scope)

    def _value(self, text, scope):
        return (yield from self._evaluated(_tree(text), scope))

    def _evaluated(self, node, scope):
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name):
            return scope[node.id] if node.id in scope else self.globals[node.id]
        if isinstance(node, ast.List):
            out = []
            for each in node.elts:
                out.append((yield from self._evaluated(each, scope)))
            return out
        if isinstance(node, ast.Subscript):
            return (yield from self._evaluated(node.value, scope))[
                (yield from self._evaluated(node.slice, scope))
            ]
        if isinstance(node, ast.UnaryOp):
            value = yield from self._evaluated(node.operand, scope)
            return not value if isinstance(node.op, ast.Not) else -value
        if isinstance(node, ast.BoolOp):
            wanted = isinstance(node.op, ast.Or)
            for each in node.values:
                value = yield from self._evaluated(each, scope)
                assert isinstance(value, bool), "and, or of what is no Boolean"
                if value == wanted:
                    return wanted
            return not wanted
        if isinstance(node, ast.BinOp | ast.Compare):
            two = node.right if isinstance(node, ast.BinOp) else node.comparators[0]
            op = node.op if isinstance(node, ast.BinOp) else node.ops[0]
            a = yield from self._evaluated(node.left, scope)
            b = yield from self._evaluated(two, scope)
            return OPERATORS[type(op)](a, b)
        assert isinstance(node, ast.Call), ast.dump(node)
        values = []
        for each in node.args:
            values.append((yield from self._evaluated(each, scope)))
        named = {}
        for each in node.keywords:
            named[each.arg] = yield from self._evaluated(each.value, scope)
        return (yield from self._call(node.func.id, values, named))

    def _call(self, name, values, named):
        if name in self.functions:
            kind, parameters, body = self.functions[name]
            assert kind == "def"
            assert not named
            assert len(parameters) == len(values), name
            try:
                yield from self._run(body, dict(zip(parameters, values, strict=True)))
            except Return as end:
                return end.value
            return None
        return (yield from getattr(self, "on_" + name)(*values, **named))

    def _move(self, kind, goal, v):
        assert not self.cell.kind, "two motions at one time"
        self.cell.start(kind, goal, v)
        while True:
            yield
            if self.cell.tick():
                return

    def on_movej(self, goal, a, v):
        yield from self._move("joint", goal, v)

    def on_movel(self, goal, a, v):
        yield from self._move("line", goal, v)

    def on_stopl(self, a):
        assert self.cell.kind == "line"
        self.cell.brake(a)
        yield

    def on_stopj(self, a):
        assert self.cell.kind == "joint"
        self.cell.brake(a)
        yield

    def on_sync(self):
        yield

    def on_sleep(self, t):
        for _ in range(int(t / self.cell.cycle)):
            yield

    def on_get_standard_digital_in(self, n):
        assert n == 0
        return self.cell.pressed()
        yield

    def on_get_tool_digital_in(self, n):
        assert n == 1
        return self.cell.pressed()
        yield

    def on_get_tcp_force(self):
        deep = 0.01 if self.cell.by_hand else float(self.cell.depth(self.cell.q[None])[0])
        return [3.0, 4.0, 5.0 + 20e3 * max(deep, 0.0), 0.0, 0.0, 0.0]  # 20 N/mm over the weight
        yield

    def on_get_actual_joint_positions(self):
        return self.cell.q.tolist()
        yield

    def on_sqrt(self, x):
        return float(np.sqrt(x))
        yield

    def on_textmsg(self, one, two=""):
        self.log.append(f"{one}{two}")
        return None
        yield

    def on_popup(self, text, title="", error=False, blocking=False):
        assert blocking
        self.popups.append(f"{title}: {text}")
        if "press and release" in text:
            self.threads[1000] = self._pressed()
        return None
        yield

    def _pressed(self):
        for k in range(9):
            self.cell.by_hand = 3 <= k < 6
            yield
