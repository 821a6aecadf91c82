"""Bring `docs/commands.md` up to date with the commands: `python docs/make_commands.py`.

Usage lines and lists of options are written anew from the program; what is between them is written by
hand, and stays. A new command gets a section that begins with its help; that of a removed one is dropped.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))

import click  # noqa: E402

from webapp.app.main import root  # noqa: E402
from webapp.cli import options  # noqa: E402

PAGE = ROOT / "docs" / "commands.md"
SHARED = "Options that `build`, `localize` and `evaluate` share"
COMMON = "Options of many commands"
_MANY = 3
"""Commands from which on an option that is the same in all of them is explained once."""

_LIMITS = {
    r"\b(-?[\d.]+)<=x<=([\d.]+)": r"\1 to \2",
    r"\bx>=([\d.]+)": r"at least \1",
    r"\bx>([\d.]+)": r"more than \1",
    r"; (?:at least [01]|more than 0)(?:\.0)?\)$": ")",
    r" \((?:at least [01]|more than 0)(?:\.0)?\)$": "",
    r"(?<![\d.])(\d+)\.0(?![\d.])": r"\1",
}
"""How limits are written in `--help`, and here: those that go without saying are left out."""

_MADE = re.compile(
    r"\A\n*`expmap [^`\n]*`\n|^(?:- `-.*\n)+|^Also (?:\[`--|the options).*\n"
    r"|^\| option \| what \|\n(?:\|.*\n)+",  # a list written by hand as a table
    re.MULTILINE,
)


def commands(command: click.Command = root, words: str = "expmap") -> Iterator[tuple[str, click.Command]]:
    """Yield all commands without groups, by their command line."""
    if not isinstance(command, click.Group):
        yield words, command
        return
    context = click.Context(command)
    for name in command.list_commands(context):
        found = command.get_command(context, name)
        assert found is not None
        yield from commands(found, f"{words} {name}")


def spelled(option: click.Option, command: click.Command) -> str:
    """Return the names of an option, with the placeholder of its value after the last."""
    *others, last = sorted(option.opts, key=len)
    value = "" if option.is_flag else option.make_metavar(click.Context(command))
    if isinstance(option.type, click.Choice):
        value = "|".join(option.type.choices)
    return ", ".join(f"`{name}`" for name in (*others, f"{last} {value}".strip()))


def row(option: click.Option, command: click.Command) -> str:
    """Return the line of an option: as `--help` explains it, with defaults and limits in brackets."""
    record = option.get_help_record(click.Context(command))
    assert record is not None
    text = re.sub(r"\] \[", "; ", " ".join(record[1].split()))
    text = re.sub(r" \[([^\]]*)\]$", r" (\1)", text)
    for pattern, words in _LIMITS.items():
        text = re.sub(pattern, words, text)
    return f"- {spelled(option, command)}: {text}\n"


def shared_names() -> set[str | None]:
    """Return the names of the options that `build`, `localize` and `evaluate` share."""

    @click.command
    @options.index_options
    @options.map_options
    def nothing() -> None: ...

    return {param.name for param in nothing.params}


def own(command: click.Command) -> list[click.Option]:
    return [p for p in command.params if isinstance(p, click.Option) and not p.hidden]


def common_rows(table: Mapping[str, click.Command]) -> dict[str, str]:
    """Return the lines, by names of options, of those that are the same in many commands."""
    lines = [(p.opts[-1], row(p, c)) for c in table.values() for p in own(c) if p.name not in shared_names()]
    rarest_first = reversed(Counter(lines).most_common())
    return dict(sorted({name: line for (name, line), n in rarest_first if n >= _MANY}.items()))


def section(words: str, command: click.Command, *, prose: str, common: Mapping[str, str]) -> str:
    """Return the section of a command: usage, what is written by hand, its options, links to the others."""
    pieces = command.collect_usage_pieces(click.Context(command))
    usage = " ".join(piece for piece in pieces if piece != "[OPTIONS]")
    shared = [p for p in own(command) if p.name in shared_names()]
    elsewhere = [p for p in own(command) if common.get(p.opts[-1]) == row(p, command)]
    rows = "".join(row(p, command) for p in own(command) if p not in (*shared, *elsewhere))
    also = [f"[`{p.opts[-1]}`](#{anchor(COMMON)})" for p in elsewhere]
    if shared:
        also.insert(0, f"the options [below](#{anchor(SHARED)})")
    parts = [f"## `{words}`", f"`{words} {usage}`" if usage else ""]
    parts += [prose or " ".join((command.help or "").split())]
    parts += [rows] if rows else []
    parts += ["Also " + ", ".join(also) + "."] if also else []
    return "\n\n".join(part.strip() for part in parts if part) + "\n\n"


def anchor(title: str) -> str:
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def page(text: str) -> str:
    """Return the page with all usage lines and lists as the program has them."""
    begin, *parts = re.split(r"^## (.+)\n", text, flags=re.MULTILINE)
    prose = {title: _MADE.sub("", body).strip() for title, body in zip(parts[::2], parts[1::2], strict=True)}
    table = dict(commands())
    common = common_rows(table)
    made = [
        section(words, command, prose=re.sub(r"\n{3,}", "\n\n", prose.get(f"`{words}`", "")), common=common)
        for words, command in table.items()
    ]
    build = table["expmap build"]
    shared = "".join(row(p, build) for p in own(build) if p.name in shared_names())
    ends = [(COMMON, "".join(common.values())), (SHARED, shared)]
    made += [_end(title, prose.get(title, ""), rows) for title, rows in ends]
    return begin + "".join(made).rstrip("\n") + "\n"


def _end(title: str, prose: str, rows: str) -> str:
    before, _, after = prose.partition("\n| matcher |")
    matchers = f"\n| matcher |{after}" if after else ""
    return (
        "\n\n".join(p for p in (f"## {title}", before.strip(), rows.strip(), matchers.strip()) if p) + "\n\n"
    )


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text("utf-8")), "utf-8")
