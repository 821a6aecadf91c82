"""What an application works out at its start, kept for the next one of this process: each test has its own.

That is code of addresses, which Werkzeug compiles anew for every rule, and code of page templates.
"""

from collections.abc import Callable

from flask import Flask
from jinja2 import BytecodeCache
from jinja2.bccache import Bucket
from werkzeug.routing import Rule

_compile_builder = Rule._compile_builder
_builders: dict[tuple[object, ...], Callable[..., tuple[str, str]]] = {}
_templates: dict[str, bytes] = {}


def remember_rules() -> None:
    """Let equal rules of all applications share the function that builds their addresses."""
    Rule._compile_builder = _remembered


def remember_templates(app: Flask) -> None:
    """Let an application share compiled templates with those before it; changed ones are compiled again."""
    app.jinja_env.bytecode_cache = _Templates()


def _remembered(rule: Rule, append_unknown: bool = True) -> Callable[..., tuple[str, str]]:
    """As the original; the function has the rule as an argument, so it depends on nothing but this key."""
    key = (repr(rule), tuple(rule._trace), repr(rule.defaults), append_unknown)
    if key not in _builders:
        _builders[key] = _compile_builder(rule, append_unknown)
    return _builders[key]


class _Templates(BytecodeCache):
    def load_bytecode(self, bucket: Bucket) -> None:
        if bucket.key in _templates:
            bucket.bytecode_from_string(_templates[bucket.key])  # ignored where the source is another

    def dump_bytecode(self, bucket: Bucket) -> None:
        _templates[bucket.key] = bucket.bytecode_to_string()
