"""Matches the names in a list to photos, regardless of folders, letter case and Unicode normalisation."""

from __future__ import annotations

import unicodedata
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

_Ending = tuple[str, ...]
"""The last parts of a path."""

_MOST_PARTS = 10
"""Parts of a path that are compared."""


@dataclass(frozen=True, slots=True)
class NameMatch:
    photo: dict[str, int]  # Id of the photo, by the list's name
    unknown: tuple[str, ...]  # Names that match no photo, or one that another name matches better
    # Names that match several photos equally well, or the same photo as another name.
    ambiguous: tuple[str, ...]


def match_names(names: Iterable[str], photos: Iterable[tuple[int, Sequence[str]]]) -> NameMatch:
    """Match the names of a list to photos.

    A photo is found by its file name; if several share it, by as many parent folders as needed, up to nine.
    The other folders are ignored, as those of the list may differ from those of the photos.

    Args:
        names: Paths, with slashes of either kind.
        photos: iterable of (int, sequence of str). Id and names of each photo: the original one, and that in
            the map.
    """
    photos_at: dict[_Ending, set[int]] = defaultdict(set)
    endings_of: dict[int, set[_Ending]] = {}
    for id, called in photos:
        endings_of[id] = {ending for name in called for ending in _endings(name)}
        for ending in endings_of[id]:
            photos_at[ending].add(id)
    first_at = {ending: min(ids) for ending, ids in photos_at.items()}
    best = {name: next((e for e in _endings(name) if e in first_at), ()) for name in names}
    claims = Counter(best.values())  # not by photo: many names can match many photos equally well
    photo, unknown, ambiguous = {}, [], []
    for name, ending in best.items():
        if not ending:
            unknown.append(name)
            continue
        id = first_at[ending]
        others = [other for other in endings_of[id] if claims[other]]
        if max(map(len, others)) > len(ending):
            unknown.append(name)
        elif len(photos_at[ending]) > 1 or sum(claims[e] for e in others if len(e) == len(ending)) > 1:
            ambiguous.append(name)
        else:
            photo[name] = id
    return NameMatch(photo, tuple(unknown), tuple(ambiguous))


def _endings(name: str) -> Iterator[_Ending]:
    """Yield the endings of a path, the longest first."""
    parts = _parts(name)[-_MOST_PARTS:]
    return (parts[first:] for first in range(len(parts)))


def _parts(name: str) -> tuple[str, ...]:
    folded = unicodedata.normalize("NFC", name).casefold().replace("\\", "/")
    return tuple(part for part in folded.split("/") if part not in ("", ".")) or ("",)
