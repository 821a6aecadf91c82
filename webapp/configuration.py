"""Load settings from the environment, a file, or their defaults.

Each setting of `webapp.settings` has a key such as `extract.max_side_px`, a variable such as
`EXPMAP_EXTRACT_MAX_SIDE_PX`, and a place in a TOML file. A command's option overrides the variable, the
variable overrides the file, and the file overrides the default.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from webapp.errors import UsageError
from webapp.settings import AtLeast, OneOf, Settings

CONFIG = "EXPMAP_CONFIG"
"""Environment variable with the path of the settings file."""

DRAINING_FD = "EXPMAP_DRAINING_FD"
"""Environment variable with the file descriptor of a server's drain pipe: see `webapp.jobs.health`."""

_INFINITE = 1e15
"""Upper limit of every numeric setting: no larger number makes sense."""

_OLD_NAMES = {
    "EXPMAP_TILES": "tile_services",
    "EXPMAP_PROXIES": "web.proxies",
    "EXPMAP_MEMORY_MB": "retrieval.memory_mb",
}
"""Deprecated variables of 0.7.0, with the settings' keys."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting that users can change."""

    key: str  # Section and name, or the name alone
    kind: Callable[[Any], Any]  # int, float, str or Path
    default: Any
    minimum: AtLeast | None  # Minimum of a number; None if it only has to be more than 0
    choices: OneOf | None = None  # Of a text; None if it can be any

    @property
    def variables(self) -> tuple[str, ...]:
        """Environment variables that set it; the first has priority."""
        others = [name for name, key in _OLD_NAMES.items() if key == self.key]
        return (_variable(self.key), *others)

    @property
    def allowed(self) -> str:
        """Description of the allowed values."""
        if self.choices is not None:
            return f"one of {', '.join(self.choices.values)}"
        if self.kind in (str, Path):
            return "a string" if self.kind is str else "a path"
        number = "a whole number" if self.kind is int else "a number"
        limit = f"of at least {self.minimum.value:g}" if self.minimum else "above 0"
        return f"{number} {limit}, for example {self.default:g}"

    def check(self, value: object, *, where: str) -> Any:
        if self._takes(value):
            return self.kind(value)
        raise UsageError(f"{value!r} is not allowed", where=where, hint=f"write {self.allowed}")

    def parse(self, text: str, *, where: str) -> Any:
        """Convert a text to the kind of the setting; errors as `check`."""
        value: object = text
        if self.kind in (int, float):
            with suppress(ValueError):
                value = self.kind(text)
        return self.check(value, where=where)

    def _takes(self, value: object) -> bool:
        if self.kind in (str, Path):
            known = self.choices is None or value in self.choices.values
            return isinstance(value, str) and bool(value) and known
        if isinstance(value, bool) or not isinstance(value, int if self.kind is int else int | float):
            return False
        return (value >= self.minimum.value if self.minimum else value > 0) and value < _INFINITE


@dataclass(frozen=True, slots=True)
class Effective:
    setting: Setting
    value: Any
    source: str  # The variable or file that sets it, or "default"


def _variable(key: str) -> str:
    return f"EXPMAP_{key.replace('.', '_').upper()}"


def settings_table() -> dict[str, Setting]:
    """Return all settings by their keys."""
    return {setting.key: setting for setting in _settings_of(Settings(), "")}


def effective_settings(environ: Mapping[str, str] | None = None) -> list[Effective]:
    """Find the value of each setting and where it comes from.

    Raises:
        UsageError: A variable or the file has an unknown setting or a value that is not allowed, or the file
            cannot be read.
    """
    env = os.environ if environ is None else environ
    table = settings_table()
    _check_variables(env, table)
    path = env.get(CONFIG)
    in_file = _read_file(Path(path), table) if path else {}
    found = []
    for key, setting in table.items():
        variable = next((name for name in setting.variables if env.get(name)), None)
        if variable is not None:
            found.append(Effective(setting, setting.parse(env[variable], where=variable), variable))
        elif key in in_file:
            found.append(Effective(setting, in_file[key], str(path)))
        else:
            found.append(Effective(setting, setting.default, "default"))
    return found


def load_settings(environ: Mapping[str, str] | None = None) -> Settings:
    """Read the settings; parameters and errors as `effective_settings`."""
    values: dict[str, dict[str, Any]] = {"": {}}
    for one in effective_settings(environ):
        section, _, name = one.setting.key.rpartition(".")
        values.setdefault(section, {})[name] = one.value
    defaults = Settings()
    sections = {name: type(getattr(defaults, name))(**own) for name, own in values.items() if name}
    return Settings(**values[""], **sections)


def rename_old_variables(environ: MutableMapping[str, str] | None = None) -> list[str]:
    """Give deprecated variables their present names, also for processes started later; say so of each."""
    env = os.environ if environ is None else environ
    messages = []
    for old, key in _OLD_NAMES.items():
        text = env.pop(old, "")
        if text:
            new = _variable(key)
            env[new] = env.get(new) or text
            messages.append(f"{old} is deprecated, and a later version will not read it: set {new} instead")
    return messages


def draining_fd() -> int | None:
    """Return the file descriptor that signals that this process's server is about to stop, if it has one."""
    number = os.environ.get(DRAINING_FD)
    return None if number is None else int(number)


def use_config(path: Path) -> None:
    """Use a settings file in this process and its child processes."""
    os.environ[CONFIG] = str(path.absolute())


def _settings_of(group: object, prefix: str) -> Iterator[Setting]:
    hints = get_type_hints(type(group), include_extras=True)
    for field in fields(group):  # type: ignore[arg-type]
        value = getattr(group, field.name)
        if is_dataclass(value):
            yield from _settings_of(value, f"{field.name}.")
            continue
        hint, rule = hints[field.name], None
        if get_origin(hint) is Annotated:
            hint, rule = get_args(hint)
        kind = next((part for part in get_args(hint) if part is not type(None)), hint)
        minimum = rule if isinstance(rule, AtLeast) else None
        choices = rule if isinstance(rule, OneOf) else None
        yield Setting(f"{prefix}{field.name}", kind, value, minimum, choices)


def _check_variables(env: Mapping[str, str], table: Mapping[str, Setting]) -> None:
    """Reject an unknown variable whose name begins like those of a section."""
    known = {name for setting in table.values() for name in setting.variables}
    sections = {key.partition(".")[0] for key in table if "." in key}
    for name in env:
        section = next((s for s in sections if name.startswith(f"EXPMAP_{s.upper()}_")), None)
        if section is not None and name not in known:
            raise UsageError("unknown setting", where=name, hint=_known(table, section))


def _read_file(path: Path, table: Mapping[str, Setting]) -> dict[str, Any]:
    """Read the settings in a file; paths in it are relative to its folder."""
    try:
        content = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise UsageError(
            f"cannot be read: {error.strerror}", where=str(path), hint=f"see {CONFIG}"
        ) from error
    except ValueError as error:
        raise UsageError(f"not a TOML file: {error}", where=str(path)) from error
    found = {}
    for key, value in _flattened(content, path, table=table):
        setting = table.get(key)
        if setting is None:
            section = key.rpartition(".")[0]
            raise UsageError("unknown setting", where=f"{path}: {key}", hint=_known(table, section))
        checked = setting.check(value, where=f"{path}: {key}")
        found[key] = path.absolute().parent / checked if setting.kind is Path else checked
    return found


def _flattened(
    content: Mapping[str, Any], path: Path, *, table: Mapping[str, Setting]
) -> Iterator[tuple[str, object]]:
    sections = {key.partition(".")[0] for key in table if "." in key}
    for name, value in content.items():
        if name not in sections:
            yield name, value
        elif isinstance(value, dict):
            yield from ((f"{name}.{own}", one) for own, one in value.items())
        else:
            raise UsageError(
                "is a section, not a setting",
                where=f"{path}: {name}",
                hint=f"write [{name}] and its settings below",
            )


def _known(table: Mapping[str, Setting], section: str) -> str:
    """List the settings of a section, or else all sections and the settings outside them."""
    if section:
        names = [key.removeprefix(f"{section}.") for key in table if key.startswith(f"{section}.")]
        return f"known in {section}: {', '.join(names)}"
    sections = dict.fromkeys(f"[{key.partition('.')[0]}]" for key in table if "." in key)
    return f"known: {', '.join([*sections, *(key for key in table if '.' not in key)])}"


def refuse_script_name() -> None:
    """Refuse to serve below a path, which gunicorn would take from the environment. Raises UsageError."""
    prefix = os.environ.get("SCRIPT_NAME", "").strip("/")
    if prefix:
        hint = "unset SCRIPT_NAME, and give the server a host name or a port of its own"
        raise UsageError(f"Experience Map cannot be served below a path (/{prefix})", hint=hint)
