"""Bring the lists in `docs/settings.md` up to date with the settings: `python docs/make_settings.py`.

What stands above the list of each group is written by hand, and stays; a new group begins with its docstring.
"""

from __future__ import annotations

import ast
import re
import sys
from dataclasses import fields, is_dataclass
from itertools import groupby, pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))

from webapp import settings  # noqa: E402
from webapp.configuration import Setting, settings_table  # noqa: E402

PAGE = ROOT / "docs" / "settings.md"
ALONE = "Without a group"
_LIST = re.compile(r"^(?:- `.*\n)+", re.MULTILINE)


def descriptions() -> dict[str, str]:
    """Return what the code says of each setting, by its key, and of each group."""
    tree = ast.parse(Path(settings.__file__).read_text("utf-8"))
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    found = _fields_of(classes["Settings"], "")
    for field in fields(settings.Settings):
        group = getattr(settings.Settings(), field.name)
        if is_dataclass(group):
            node = classes[type(group).__name__]
            found |= {field.name: ast.get_docstring(node) or ""} | _fields_of(node, f"{field.name}.")
    return found


def _fields_of(node: ast.ClassDef, group: str) -> dict[str, str]:
    return {
        group + field.target.id: " ".join(str(text.value.value).split())
        for field, text in pairwise(node.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
    }


def line(setting: Setting, text: str) -> str:
    """Return the line of a setting: its key, default and description."""
    default = "none" if setting.default is None else str(setting.default).removesuffix(".0")
    return f"- `{setting.key}` ({default}): {text}\n"


def page(text: str) -> str:
    """Return the page with all settings as the program has them."""
    begin, *parts = re.split(r"^### (.+)\n", text, flags=re.MULTILINE)
    prose = {t: _LIST.sub("", body).strip() for t, body in zip(parts[::2], parts[1::2], strict=True)}
    said = descriptions()
    made = []
    for group, members in groupby(settings_table().values(), lambda one: one.key.rpartition(".")[0]):
        title = f"`{group}`" if group else ALONE
        lines = "".join(line(one, said[one.key]) for one in members)
        above = prose.get(title) or said.get(group, "")
        made.append("\n\n".join(part for part in (f"### {title}", above, lines) if part))
    return begin + "\n".join(made)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text("utf-8")), "utf-8")
