"""Limits on the sizes of files, functions and parameter lists.

- A file has at most 600 lines: what belongs together is not cut up.
- A function's body without its docstring has at most 60 lines, and 95 % of them at most 40. Migrations, which
  list changes of the tables, are not counted.
- A function has at most 6 parameters. Those of commands, which are options, and of views, which are parts of
  the address and the request, are not counted.
- Public functions take at most two parameters by position, private ones three; `self` and `cls` are not
  counted; the coordinates `x, y` count as one, and so does a `record`, a mission or a track with the
  `session` that it belongs to.
"""

import ast
from collections.abc import Iterator
from typing import NamedTuple

import pytest

FILE_LINES = 600
BODY_LINES, USUAL_BODY_LINES, USUAL_SHARE = 60, 40, 0.95
PARAMETERS, BY_POSITION, BY_POSITION_PRIVATE = 6, 2, 3
RECORDS = {"record", "mission", "mission_id", "track"}


class Function(NamedTuple):
    """A function or method, and its location."""

    place: str
    node: ast.FunctionDef | ast.AsyncFunctionDef
    public: bool
    in_class: bool

    def body_lines(self) -> int:
        """Return the number of lines from the first statement after the docstring to the end."""
        body = self.node.body[ast.get_docstring(self.node) is not None :]
        return self.node.end_lineno - body[0].lineno + 1 if body else 0

    def by_position(self) -> list[str]:
        """Return the names of the positional parameters."""
        taken = [a.arg for a in (*self.node.args.posonlyargs, *self.node.args.args)]
        bound = self.in_class and not any(_last_name(d) == "staticmethod" for d in self.node.decorator_list)
        return taken[bound:]

    def parameters(self) -> int:
        """Return the number of all parameters."""
        rest = (self.node.args.vararg, self.node.args.kwarg)
        return len(self.by_position()) + len(self.node.args.kwonlyargs) + sum(r is not None for r in rest)

    def is_command(self) -> bool:
        """Return whether the parameters are a command's options, or come with a request."""
        names = ("command", "group", "get", "post", "put", "patch", "delete", "route")
        return any(_last_name(d) in names for d in self.node.decorator_list)


def _last_name(decorator: ast.expr) -> str:
    called = decorator.func if isinstance(decorator, ast.Call) else decorator
    return called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")


def _functions(node: ast.AST, place: str, *, public: bool, in_class: bool) -> Iterator[Function]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            shown = public and (not child.name.startswith("_") or child.name == "__init__")
            yield Function(f"{place}:{child.lineno} {child.name}", child, shown, in_class)
            yield from _functions(child, place, public=False, in_class=False)
        else:
            is_class = isinstance(child, ast.ClassDef)
            shown = public and not (is_class and child.name.startswith("_"))
            yield from _functions(child, place, public=shown, in_class=is_class)


@pytest.fixture(scope="module")
def functions(modules, project):
    """All functions of the program."""
    return [
        function
        for module in modules
        for function in _functions(
            module.tree, str(module.path.relative_to(project)), public=True, in_class=False
        )
    ]


def test_files_are_short(modules):
    lines = {str(module.path): len(module.text.splitlines()) for module in modules}
    assert {path: count for path, count in lines.items() if count > FILE_LINES} == {}


def test_functions_are_short(functions):
    lines = {f.place: f.body_lines() for f in functions if "migrations/versions" not in f.place}
    assert {place: count for place, count in lines.items() if count > BODY_LINES} == {}
    usual = sum(count <= USUAL_BODY_LINES for count in lines.values())
    assert usual >= USUAL_SHARE * len(lines)


def test_parameters_are_few(functions):
    many = {f.place: f.parameters() for f in functions if f.parameters() > PARAMETERS and not f.is_command()}
    assert many == {}


def test_parameters_after_the_second_have_names(functions):
    broken = {}
    for function in functions:
        taken = function.by_position()
        count = (
            len(taken)
            - ("x" in taken and "y" in taken)
            - (taken[:1] == ["session"] and set(taken[1:2]) <= RECORDS)
        )
        most = BY_POSITION if function.public else BY_POSITION_PRIVATE
        if count > most and not function.is_command():
            broken[function.place] = taken
    assert broken == {}
