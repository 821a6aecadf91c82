"""The fields of a `.cfg`, one parser each; the strict reader and the linter share them."""

from __future__ import annotations

import re
from decimal import Decimal

from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.mapmodel.findings import Code, quoted
from webapp.core.mapmodel.paths import name_problem
from webapp.core.mapmodel.positions import round_half_up

_INTEGER = re.compile(r"-?[0-9]+")
_FRACTION = re.compile(r"(-?[0-9]{1,10})[.,]([0-9]{0,10})")


class FieldError(Exception):
    """A field breaks the format.

    Parameters
    ----------
    code : Code
    message : str
    better : str, optional
        The text that should stand there instead, where it can be told.
    """

    def __init__(self, code: Code, message: str, *, better: str | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.better = better


def parse_name(text: str) -> str:
    """Read the path of a photo or image.

    Raises
    ------
    FieldError
        Empty, or not a path that stays below the map's folder.
    """
    problem = name_problem(text)
    if problem:
        raise FieldError(problem.code, problem.message, better=problem.better)
    return text


def parse_id(text: str) -> int:
    """Read an id: digits only, at most 2147483647.

    Raises
    ------
    FieldError
    """
    if not _INTEGER.fullmatch(text):
        better = text[1:] if _INTEGER.fullmatch(text[1:]) and text[0] == "+" else None
        raise FieldError(Code.NON_NUMERIC_ID, f"the id {quoted(text)} is not a whole number", better=better)
    return _limited(text, "the id", smallest=0)


def parse_size(text: str, what: str) -> int:
    """Read the image's width or height in pixels, from 1.

    Raises
    ------
    FieldError
    """
    return _limited(_whole(text, what), what, smallest=1)


def parse_coordinate(text: str, what: str) -> int:
    """Read x or y in whole pixels; whether it is on the image is checked where the image is known.

    Raises
    ------
    FieldError
    """
    return _limited(_whole(text, what), what, smallest=-MAX_NUMBER)


def _whole(text: str, what: str) -> str:
    if _INTEGER.fullmatch(text):
        return text
    if not text:
        raise FieldError(Code.NOT_AN_INTEGER, f"{what} is empty: a whole number of pixels is needed")
    fraction = _FRACTION.fullmatch(text)
    better = str(round_half_up(float(Decimal(f"{fraction[1]}.{fraction[2]}0")))) if fraction else None
    if fraction and "," in text:
        message = f"{what} = {quoted(text)} has a decimal comma: pixels are whole numbers"
        raise FieldError(Code.DECIMAL_COMMA, message, better=better)
    if text[0] == "+" and _INTEGER.fullmatch(text[1:]):
        better = text[1:]
    message = f"{what} = {quoted(text)} is not a whole number in plain digits"
    raise FieldError(Code.NOT_AN_INTEGER, message, better=better)


def _limited(text: str, what: str, *, smallest: int) -> int:
    """Turn digits into a number, long ones first refused by their length."""
    sign, digits = ("-", text[1:]) if text.startswith("-") else ("", text)
    digits = digits.lstrip("0") or "0"
    value = int(sign + digits) if len(digits) <= 10 else None
    if value is None or not smallest <= value <= MAX_NUMBER:
        message = f"{what} = {quoted(text)} is not between {smallest} and {MAX_NUMBER}"
        raise FieldError(Code.NUMBER_OUT_OF_RANGE, message)
    return value
