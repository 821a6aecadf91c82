"""Matches the names in a list to photos, regardless of folders, letter case and Unicode normalisation."""

from __future__ import annotations

import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

_Called = tuple[int, tuple[str, ...]]
"""Id of a photo, and the parts of one of its paths."""


@dataclass(frozen=True, slots=True)
class NameMatch:
    """The photos that the names of a list refer to.

    Attributes
    ----------
    photo : dict of str to int
        Id of the photo, by the list's name.
    unknown : tuple of str
        Names that match no photo, or one that another name matches better.
    ambiguous : tuple of str
        Names that match several photos equally well, or the same photo as another name.
    """

    photo: dict[str, int]
    unknown: tuple[str, ...]
    ambiguous: tuple[str, ...]


def match_names(names: Iterable[str], photos: Iterable[tuple[int, Sequence[str]]]) -> NameMatch:
    """Match the names of a list to photos.

    A photo is found by its file name; if several share it, by as many parent folders as needed. The other
    folders are ignored, as those of the list may differ from those of the photos.

    Parameters
    ----------
    names : iterable of str
        Paths, with slashes of either kind.
    photos : iterable of (int, sequence of str)
        Id and names of each photo: the original one, and that in the map.
    """
    by_last: dict[str, list[_Called]] = defaultdict(list)
    for id, called in photos:
        for parts in {_parts(name) for name in called}:
            by_last[parts[-1]].append((id, parts))
    best = {name: _closest(_parts(name), by_last) for name in names}
    claims: dict[int, list[int]] = defaultdict(list)
    for common, ids in best.values():
        for id in ids:
            claims[id].append(common)
    photo, unknown, ambiguous = {}, [], []
    for name, (common, ids) in best.items():
        id = min(ids, default=-1)
        if not ids or max(claims[id]) > common:
            unknown.append(name)
        elif len(ids) > 1 or claims[id].count(common) > 1:
            ambiguous.append(name)
        else:
            photo[name] = id
    return NameMatch(photo, tuple(unknown), tuple(ambiguous))


def _closest(parts: tuple[str, ...], by_last: dict[str, list[_Called]]) -> tuple[int, set[int]]:
    """Return the length of the longest common suffix of a path with photos' paths, and these photos."""
    alike = [(_common(parts, other), id) for id, other in by_last.get(parts[-1], [])]
    most = max((count for count, _ in alike), default=0)
    return most, {id for count, id in alike if count == most}


def _common(one: tuple[str, ...], other: tuple[str, ...]) -> int:
    count = 0
    for a, b in zip(reversed(one), reversed(other), strict=False):
        if a != b:
            break
        count += 1
    return count


def _parts(name: str) -> tuple[str, ...]:
    folded = unicodedata.normalize("NFC", name).casefold().replace("\\", "/")
    return tuple(part for part in folded.split("/") if part not in ("", ".")) or ("",)
