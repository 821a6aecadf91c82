"""The declaration of a fact of a photo, from which files, records, edits, API, shares and pages derive.

The facts are fields of `webapp.core.mapmodel.model.MapPhoto`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal, NamedTuple

from webapp.core.texts import has_controls, is_line


@dataclass(frozen=True, slots=True)
class NumberForm:
    """A number, and a description of the valid ones for errors."""

    valid_ones: str
    is_valid: Callable[[float], bool]


@dataclass(frozen=True, slots=True)
class TextForm:
    """A text of at most so many characters, of one line or of any number; None: any text."""

    most: int | None = None
    lines: bool = False

    def problem(self, text: str) -> str | None:
        """Return what is wrong with a text; None if it is valid. The empty text is: it stands for none."""
        if self.most is None or not text:
            return None
        if not self.lines and not is_line(text, most=self.most):
            return f"must be one line of at most {self.most} readable characters, without spaces at its ends"
        if len(text) > self.most or has_controls(text, besides="\n\t"):
            return f"must be at most {self.most} characters, and no control characters"
        return None


DESCRIPTION = TextForm(most=300)
"""Form of a map's description."""


class FixedForm(Enum):
    HEADING = "degrees clockwise from north"
    TIME = "ISO 8601"
    BOXES = "parts of the photo: a tuple of BlurBox"
    SOURCE = "a PhotoSource"
    SPHERE = "a Panorama"


Form = NumberForm | TextForm | FixedForm
"""Form of a fact in JSON and in the database, which are the same: `webapp.files.maps.facts` converts it."""


class Edited(NamedTuple):
    """How people change a fact; each change can be undone, and its `kind` names the undo button."""

    kind: str
    description: str
    example: str | None = None


@dataclass(frozen=True, slots=True)
class Fact:
    """What a photo of a map has, apart from its position and its file; descriptions are for the API."""

    form: Form
    description: str = ""
    label: str = ""
    """On pages; needed for texts that people edit, which get a field and a filter."""
    visitors: Literal["always", "originals", "notes"] | None = None
    """Whether visitors of a shared map see it: always, if the share allows originals or notes, or never."""
    edited: Edited | None = None
    """None if people do not change it."""


def fact(form: Form, *, default: object = None, **about: Any) -> Any:
    """Declare a field of a dataclass as a fact; see `Fact`."""
    return field(default=default, metadata={"fact": Fact(form, **about)})
