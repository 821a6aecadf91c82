"""Caches start-up work of applications within the process, as each test makes its own application.

Cached are the URL rules compiled by Werkzeug, and compiled templates.
"""

from dataclasses import dataclass
from typing import Any

from flask import Flask
from jinja2 import BytecodeCache
from jinja2.bccache import Bucket
from werkzeug.routing import Rule

_compile = Rule.compile
_compiled: dict[tuple[object, ...], "_Compiled"] = {}
_templates: dict[str, bytes] = {}


@dataclass(frozen=True, slots=True)
class _Compiled:
    """The compiled form of a rule; the functions that build its address take the rule as an argument."""

    attributes: dict[str, Any]
    arguments: frozenset[str]
    build: Any
    build_unknown: Any


def remember_rules() -> None:
    """Let equal rules of all applications share their compiled form."""
    Rule.compile = _remembered


def remember_templates(app: Flask) -> None:
    """Let an application share compiled templates with earlier ones; changed ones are compiled again."""
    app.jinja_env.bytecode_cache = _Templates()


def _remembered(rule: Rule) -> None:
    converters = tuple(rule.map.converters.items())
    settings = rule.map.host_matching, rule.host, rule.subdomain, rule.merge_slashes, repr(rule.defaults)
    key = (rule.rule, *settings, converters)
    if (known := _compiled.get(key)) is None:
        _compile(rule)
        _compiled[key] = _Compiled(
            {name: getattr(rule, name) for name in ("_parts", "_trace", "_converters")},
            frozenset(rule.arguments),
            rule._build.__func__,
            rule._build_unknown.__func__,
        )
        return
    vars(rule).update(known.attributes)
    rule.arguments |= known.arguments
    rule._build = known.build.__get__(rule, None)
    rule._build_unknown = known.build_unknown.__get__(rule, None)


class _Templates(BytecodeCache):
    def load_bytecode(self, bucket: Bucket) -> None:
        if bucket.key in _templates:
            bucket.bytecode_from_string(_templates[bucket.key])  # ignored if the source differs

    def dump_bytecode(self, bucket: Bucket) -> None:
        _templates[bucket.key] = bucket.bytecode_to_string()
