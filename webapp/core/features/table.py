"""Registry of detectors, extractors and matchers, and which of them work together."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from webapp.core.features import keypoint_networks, orb, sift, surf, xfeat
from webapp.core.features.entry import FeatureEntry
from webapp.core.features.types import Engine, Kind
from webapp.errors import UsageError

Method = Literal["auto", "vote", "verified", "thorough", "landmarks"]

METHODS: tuple[Method, ...] = ("auto", "vote", "verified", "thorough", "landmarks")

_VERIFY: tuple[Method, ...] = ("auto", "verified", "thorough", "landmarks")

LANDMARK_FEATURES = "sift"
"""Features of the points of a reconstruction, and hence of the query in method `landmarks`."""

EXTRACTORS: dict[str, FeatureEntry] = {
    entry.name: entry
    for entry in (*sift.ENTRIES, *surf.ENTRIES, *orb.ENTRIES, *xfeat.ENTRIES, *keypoint_networks.ENTRIES)
}
"""By name; the first is the default."""

DETECTORS = {name: entry for name, entry in EXTRACTORS.items() if entry.detector == name}

BUNDLES = {name: (entry.detector, name) for name, entry in EXTRACTORS.items() if not entry.pairs_of_bits}
"""`--features NAME`: detector and extractor; the matcher follows from the method."""

PAIR_MATCHERS = {name: e.pair_matcher.name for name, e in EXTRACTORS.items() if e.pair_matcher is not None}
"""Features of method `thorough`, and the models that match them; the default first."""


@dataclass(frozen=True, slots=True)
class MatcherEntry:
    """A matcher: the kinds of descriptors it compares, for which methods, and how (a phrase)."""

    kinds: tuple[Kind, ...]
    methods: tuple[Method, ...]
    does: str


_BOTH: tuple[Kind, ...] = ("float", "binary")

MATCHERS: dict[str, MatcherEntry] = {
    "flann": MatcherEntry(_BOTH, METHODS, "approximate: kd-trees for float, LSH for binary descriptors"),
    "l1": MatcherEntry(("float",), METHODS, "brute force, sum of absolute differences"),
    "l2": MatcherEntry(("float",), METHODS, "brute force, Euclidean distance"),
    "hamming": MatcherEntry(("binary",), METHODS, "brute force, number of different bits"),
    "hamming2": MatcherEntry(("binary",), METHODS, "brute force, number of different pairs of bits"),
    "ivf": MatcherEntry(_BOTH, _VERIFY, "approximate: inverted file, read from the index"),
    "vlad": MatcherEntry(
        ("float",), _VERIFY, "two stages: aggregated vectors select photos, which are compared exactly"
    ),
}

_OTHER_NAMES = {
    "flannbased": "flann",
    "bruteforce": "l2",
    "bruteforcel1": "l1",
    "bruteforcel2": "l2",
    "bruteforcehamming": "hamming",
    "bruteforcehamming2": "hamming2",
    **{other: name for name, entry in EXTRACTORS.items() for other in entry.other_names},
}

_DEFAULT_MATCHERS = ("ivf", "hamming", "flann", "hamming2")
"""The default matcher is the first of these that fits extractor and method."""


@dataclass(frozen=True, slots=True)
class FeatureChoice:
    """A valid combination of detector, extractor and matcher."""

    # `detector`, `extractor`, `matcher`: Names in the tables of this module.
    detector: str
    extractor: str
    matcher: str
    weights: str = ""  # SHA-256 of a model file supplied by the user, as another file gives other features

    @property
    def name(self) -> str:
        """The bundle's name, or "detector+extractor"."""
        for name, pair in BUNDLES.items():
            if pair == (self.detector, self.extractor):
                return name
        return f"{self.detector}+{self.extractor}"

    @property
    def kind(self) -> Kind:
        """How the descriptors are compared."""
        return EXTRACTORS[self.extractor].make().kind

    @property
    def engine(self) -> Engine | None:
        """Search engine that the index must have; None for matchers that read the raw descriptors."""
        if self.matcher == "ivf":
            return "ivf"
        return "vlad" if self.matcher == "vlad" else None

    @property
    def width(self) -> int:
        return EXTRACTORS[self.extractor].make().width

    @property
    def oriented(self) -> bool:
        """Whether keypoints have an orientation; otherwise all their angles are 0."""
        return EXTRACTORS[self.detector].make().oriented

    @property
    def model(self) -> str | None:
        """Name of the model whose weights are needed; None if no model is."""
        return next((name for name in (self.detector, self.extractor) if EXTRACTORS[name].model), None)


def choose(
    method: Method,
    *,
    features: str = "auto",
    detector: str | None = None,
    extractor: str | None = None,
    matcher: str | None = None,
) -> FeatureChoice:
    """Resolve a request to a valid combination.

    Args:
        features: A bundle's name, or "auto".
        detector, extractor, matcher: Each overrides its part of the bundle.

    Raises:
        UsageError: A name is unknown or the parts are incompatible; the hint lists alternatives.
    """
    bundle = _known(features, {"auto": None, **BUNDLES}, "features")
    base_detector, base_extractor = BUNDLES[_best(method) if bundle == "auto" else bundle]
    chosen_detector = _known(detector, DETECTORS, "detector") if detector else base_detector
    chosen_extractor = _known(extractor, EXTRACTORS, "extractor") if extractor else base_extractor
    if detector and not extractor and bundle == "auto" and chosen_detector in EXTRACTORS:
        chosen_extractor = chosen_detector
    if extractor and not detector and bundle == "auto":
        chosen_detector = EXTRACTORS[chosen_extractor].detector
    default = next(m for m in _DEFAULT_MATCHERS if _fits(m, chosen_extractor, method))
    chosen_matcher = _known(matcher, MATCHERS, "matcher") if matcher else default
    if chosen_matcher == "hamming2" and chosen_extractor == "orb":
        chosen_extractor = "orb-wta4"  # Hamming2 counts pairs of bits, which only WTA_K = 4 produces
    choice = FeatureChoice(chosen_detector, chosen_extractor, chosen_matcher)
    _reject_foreign_keypoints(choice)
    _reject_combination(choice, method)
    return choice


def _best(method: Method) -> str:
    return next(iter(PAIR_MATCHERS if method == "thorough" else EXTRACTORS))


def _fits(matcher: str, extractor: str, method: Method) -> bool:
    entry = MATCHERS[matcher]
    if EXTRACTORS[extractor].pairs_of_bits and matcher != "hamming2":
        return False
    return EXTRACTORS[extractor].make().kind in entry.kinds and method in entry.methods


def _reject_foreign_keypoints(choice: FeatureChoice) -> None:
    detector, extractor = choice.detector, choice.extractor
    if detector == extractor:
        return
    if EXTRACTORS[extractor].own_keypoints:
        message = f"{extractor} describes only its own keypoints, not those of {detector}"
        raise UsageError(message, where="--extractor", hint=f"use --features {extractor}")
    if EXTRACTORS[detector].model and EXTRACTORS[extractor].model:
        message = f"{detector} and {extractor} need different models; only one can be used"
        hint = f"use --features {detector} or --features {extractor}"
        raise UsageError(message, where="--extractor", hint=hint)


def _reject_combination(choice: FeatureChoice, method: Method) -> None:
    if method == "thorough" and choice.name not in PAIR_MATCHERS:
        fitting = " or ".join(PAIR_MATCHERS)
        message = f"method thorough has no network for features {choice.name}"
        raise UsageError(message, where="--features", hint=f"use --features {fitting}")
    if method == "landmarks" and choice.name != LANDMARK_FEATURES:
        message = f"landmarks are described by {LANDMARK_FEATURES}, not by {choice.name}"
        raise UsageError(message, where="--features", hint=f"use --features {LANDMARK_FEATURES}")
    if _fits(choice.matcher, choice.extractor, method):
        return
    fitting = ", ".join(m for m in MATCHERS if _fits(m, choice.extractor, method))
    hint = f"with --method {method} and --extractor {choice.extractor} these work: {fitting}"
    if method not in MATCHERS[choice.matcher].methods:
        message = f"matcher {choice.matcher} does not work with method {method}"
    elif choice.kind not in MATCHERS[choice.matcher].kinds:
        message = (
            f"matcher {choice.matcher} cannot compare the {choice.kind} descriptors of {choice.extractor}"
        )
        others = [b for b, (_, extractor) in BUNDLES.items() if _fits(choice.matcher, extractor, method)]
        hint = f"use --features {' or '.join(others)}; {hint}"
    else:
        message = (
            f"descriptors of {choice.extractor} consist of pairs of bits, which {choice.matcher} would split"
        )
    raise UsageError(message, where="--matcher", hint=hint)


def _known(name: str, table: Mapping[str, object], what: str) -> str:
    plain = name.strip().lower()
    if plain in table:
        return plain
    other = _OTHER_NAMES.get(re.sub(r"[^a-z0-9]", "", plain))
    if other is not None and other in table:
        return other
    raise UsageError(f"unknown {what} {name!r}", where=f"--{what}", hint=f"known: {', '.join(table)}")
