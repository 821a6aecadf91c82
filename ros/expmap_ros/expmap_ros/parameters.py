"""Parameters of a node: declared with descriptions, and checked when it starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

Value = bool | int | float | str


class ParameterError(Exception):
    """A parameter is invalid; the message names it."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter, as in the table in docs/ros-nodes.md."""

    name: str
    default: Value
    description: str
    limits: tuple[float, float] | None = None  # (least, most). Range of a number.
    choices: tuple[str, ...] = ()  # Allowed values of a text; empty for any

    def descriptor(self) -> ParameterDescriptor:
        """Return the descriptor for `ros2 param describe`; read-only, since parameters are read once."""
        made = ParameterDescriptor(name=self.name, description=self.description, read_only=True)
        made.additional_constraints = f"one of {', '.join(self.choices)}" if self.choices else ""
        if self.limits is not None and isinstance(self.default, float):
            low, high = map(float, self.limits)
            made.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        elif self.limits is not None:
            low_int, high_int = map(int, self.limits)
            made.integer_range = [IntegerRange(from_value=low_int, to_value=high_int)]
        return made


def declare(node: Node, parameters: Sequence[Parameter]) -> Mapping[str, Any]:
    """Declare parameters, and return their values. Raises ParameterError."""
    values = {}
    for parameter in parameters:
        try:
            declared = node.declare_parameter(parameter.name, parameter.default, parameter.descriptor())
        except InvalidParameterTypeException as error:
            kind = type(parameter.default).__name__.replace("str", "text")
            raise ParameterError(
                f"{parameter.name}: a {kind} is needed, such as {error_example(parameter)}"
            ) from error
        except InvalidParameterValueException as error:
            raise ParameterError(f"{parameter.name}: {_limits(parameter)}") from error
        if parameter.choices and declared.value not in parameter.choices:
            raise ParameterError(f"{parameter.name}: choose one of {', '.join(parameter.choices)}")
        values[parameter.name] = declared.value
    return values


def error_example(parameter: Parameter) -> str:
    """Return an example of a value of the right type, in the syntax of a command line."""
    return (
        f"{parameter.name}:={parameter.default!r}" if parameter.default != "" else f"{parameter.name}:='text'"
    )


def _limits(parameter: Parameter) -> str:
    low, high = parameter.limits or (0.0, 0.0)
    return f"a number from {low:g} to {high:g} is needed"


def numbers(name: str, text: str, names: Sequence[str]) -> tuple[float, ...] | None:
    """Parse `50.0755,14.4378`, one number for each of `names`; return None for an empty text.

    Raises ParameterError.
    """
    if not text:
        return None
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != len(names):
        raise ParameterError(f"{name}: write {','.join(names)}, not {text!r}")
    return found


def names(name: str, text: str, parts: Sequence[str]) -> tuple[str, ...] | None:
    """Parse `odom,base_link`, one word for each of `parts`; return None for an empty text.

    Raises ParameterError.
    """
    if not text:
        return None
    found = tuple(part.strip() for part in text.split(","))
    if len(found) != len(parts) or not all(found):
        raise ParameterError(f"{name}: write {','.join(parts)}, not {text!r}")
    return found


def file_of(name: str, text: str) -> Path:
    """Return the path of the file given by a parameter. Raises ParameterError."""
    path = Path(text).expanduser()
    if not text or not path.is_file():
        raise ParameterError(f"{name}: file {text!r} not found")
    return path


def token_of(text: str) -> str:
    """Read the token from the file `token_file`; it is not itself a parameter, since those are public.

    Raises ParameterError.
    """
    return file_of("token_file", text).read_text("utf-8").strip()


SERVER = (
    Parameter("server_url", "", "Address of the server, such as https://maps.example.org."),
    Parameter("token_file", "", "File with the token that `expmap account token --name NAME` printed."),
)
"""Parameters of every node that uses a server."""
