"""Assertions in loops: a test all of whose loops were empty has tested nothing, and fails."""

import ast
import inspect
import sys
import textwrap
from collections.abc import Callable
from functools import cache

import pytest

ASSERTING = ("assert_", "raises", "warns", "fail")


@cache
def in_loops(function: Callable) -> frozenset[int]:
    """Lines of the assertions of a test where every one of them stands in a loop; else none."""
    text, first = inspect.getsourcelines(function)
    lines, free = set[int](), False

    def visit(node: ast.AST, inside: bool) -> None:
        nonlocal free
        for child in ast.iter_child_nodes(node):
            called = getattr(child, "func", None)  # of a call
            refused = getattr(called, "id", "") == "refused"
            if isinstance(child, ast.Assert) or refused or getattr(called, "attr", "").startswith(ASSERTING):
                lines.add(first + child.lineno - 1)
                free |= not inside
            visit(child, inside or isinstance(child, ast.For | ast.While))

    visit(ast.parse(textwrap.dedent("".join(text))), False)
    return frozenset() if free else frozenset(lines)


def asserting(function: Callable, call: Callable[[], object]) -> object:
    """Call a test; it fails if its assertions stand in loops and none of them was reached."""
    lines, file = set(in_loops(function)), function.__code__.co_filename
    if not lines or sys.gettrace() is not None:  # a debugger has the trace
        return call()

    def line(frame, event, value):
        if frame.f_lineno in lines:
            lines.clear()
            sys.settrace(None)
            return None
        return line

    sys.settrace(lambda frame, event, value: line if frame.f_code.co_filename == file else None)
    try:
        out = call()
    finally:
        sys.settrace(None)
    if lines:
        pytest.fail(f"no assertion of {function.__name__} was reached: its loops are empty")
    return out
