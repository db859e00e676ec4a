"""Mutants of a module: small changes of its source that tests should detect.

A mutant replaces a range of the source text, found by the positions that ``ast`` gives. Annotations, docstrings, type
aliases and module constants are left alone: a change there alters nothing, or only a limit's exact value.
"""

import ast
import re
from bisect import bisect_right
from typing import Any, List, NamedTuple, Optional, Tuple

COMPARISONS = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: (r"is\s+not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: (r"not\s+in", "in"),
}

OPERATORS = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "+"), ast.FloorDiv: ("//", "*")}


class Mutant(NamedTuple):
    """A change of one place.

    Attributes:
        line: Line of the change, counted from 1.
        start: Offset of the replaced range in the source's UTF-8 bytes.
        end: Offset behind that range.
        text: Replacement.
        operator: Name of the mutation operator.
    """

    line: int
    start: int
    end: int
    text: str
    operator: str

    def apply(self, source: str) -> str:
        """Return the mutated source."""
        data = source.encode()
        return (data[: self.start] + self.text.encode() + data[self.end :]).decode()

    def describe(self, source: str) -> str:
        """Return the changed line before and after."""
        before = source.splitlines()[self.line - 1].strip()
        after = self.apply(source).splitlines()[self.line - 1].strip()
        return f"{before}  =>  {after}"


def mutants(source: str) -> "list[Mutant]":
    """Return all mutants of a module's source, in the order of their places."""
    finder = _Finder(source)
    finder.visit(ast.parse(source))
    return sorted(finder.mutants, key=lambda mutant: (mutant.start, mutant.end, mutant.text))


def _compiles(function: str) -> bool:
    """Return whether the text of a function compiles, with the indentation that it has."""
    try:
        ast.parse(f"if 1:\n{function}" if function[:1].isspace() else function)
    except SyntaxError:
        return False
    return True


class _Finder(ast.NodeVisitor):
    def __init__(self, source: str) -> None:
        self.mutants: List[Mutant] = []
        self._data = source.encode()
        self._lines = [0]
        for line in self._data.splitlines(keepends=True):
            self._lines.append(self._lines[-1] + len(line))
        # Start and end of the innermost function, with its indentation.
        self._function: Optional[Tuple[int, int]] = None

    def _start(self, node: Any) -> Any:
        return self._lines[node.lineno - 1] + node.col_offset

    def _end(self, node: Any) -> Any:
        return self._lines[node.end_lineno - 1] + node.end_col_offset

    def _text(self, node: Any) -> str:
        return self._data[self._start(node) : self._end(node)].decode()

    def _add(self, start: Any, end: Any, text: str, operator: str) -> None:
        if self._function is None:
            return
        first, last = self._function
        # The rest of the module is unchanged.
        if _compiles((self._data[first:start] + text.encode() + self._data[end:last]).decode()):
            self.mutants.append(Mutant(bisect_right(self._lines, start), start, end, text, operator))

    def _between(self, left: Any, right: Any, pattern: str, text: Any, operator: str) -> None:
        """Replace an operator that stands between two operands, beside parentheses and comments."""
        start, end = self._end(left), self._start(right)
        match = re.search(
            pattern.encode(), re.sub(rb"#[^\n]*", lambda m: b"#" * len(m.group()), self._data[start:end])
        )
        if match is not None:
            self._add(start + match.start(), start + match.end(), text, operator)

    # Scopes and places without behaviour

    def visit_FunctionDef(self, node: Any) -> None:
        first_line = min(part.lineno for part in (node, *node.decorator_list))
        outer, self._function = self._function, (self._lines[first_line - 1], self._end(node))
        body = node.body
        if isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
            body = body[1:]  # the docstring
        for statement in body:
            self.visit(statement)
        self._function = outer

    def visit_AsyncFunctionDef(self, node: Any) -> None:
        self.visit_FunctionDef(node)

    def visit_AnnAssign(self, node: Any) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_If(self, node: Any) -> None:
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return
        self._add(self._start(node.test), self._end(node.test), f"not ({self._text(node.test)})", "condition")
        self.generic_visit(node)

    # Expressions

    def visit_Compare(self, node: Any) -> None:
        operands = [node.left, *node.comparators]
        for left, operator, right in zip(operands, node.ops, operands[1:]):
            pattern, text = COMPARISONS[type(operator)]
            self._between(left, right, pattern, text, "comparison")
        self.generic_visit(node)

    def visit_BoolOp(self, node: Any) -> None:
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:]):
            self._between(left, right, rf"\b{old}\b", new, "logic")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: Any) -> None:
        if isinstance(node.op, ast.Not):
            self._add(self._start(node), self._end(node), f"bool({self._text(node.operand)})", "logic")
        self.generic_visit(node)

    def visit_BinOp(self, node: Any) -> None:
        if type(node.op) in OPERATORS:
            old, new = OPERATORS[type(node.op)]
            self._between(node.left, node.right, re.escape(old), new, "arithmetic")
        self.generic_visit(node)

    def visit_Constant(self, node: Any) -> None:
        if isinstance(node.value, bool):
            self._add(self._start(node), self._end(node), str(not node.value), "constant")
        elif isinstance(node.value, int):
            self._add(self._start(node), self._end(node), str(node.value + 1), "constant")

    # Statements

    def visit_Expr(self, node: Any) -> None:
        if isinstance(node.value, ast.Call):
            self._add(self._start(node), self._end(node), "pass", "statement")
        self.generic_visit(node)

    def visit_Assign(self, node: Any) -> None:
        if any(isinstance(target, (ast.Attribute, ast.Subscript)) for target in node.targets):
            self._add(self._start(node), self._end(node), "pass", "statement")
        self.generic_visit(node)

    def visit_AugAssign(self, node: Any) -> None:
        self._add(self._start(node), self._end(node), "pass", "statement")
        self.generic_visit(node)

    def visit_Raise(self, node: Any) -> None:
        self._add(self._start(node), self._end(node), "pass", "statement")

    def visit_Return(self, node: Any) -> None:
        if node.value is not None and not (isinstance(node.value, ast.Constant) and node.value.value is None):
            self._add(self._start(node), self._end(node), "return None", "return")
        self.generic_visit(node)
