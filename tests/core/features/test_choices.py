"""Accepted combinations of detector, extractor and matcher, and error messages for the others."""

import itertools

import pytest

from webapp.core.features.table import BUNDLES, DETECTORS, EXTRACTORS, MATCHERS, Method, choose
from webapp.errors import UsageError

BY_KIND = {"float": {"flann", "l1", "l2", "ivf", "vlad"}, "binary": {"flann", "hamming", "hamming2", "ivf"}}
FITTING = {name: BY_KIND[entry.make().kind] for name, entry in EXTRACTORS.items()}
FITTING["orb-wta4"] = {"hamming2"}

LEARNED = {name for name, entry in EXTRACTORS.items() if entry.model}
MATCHED = [name for name, entry in EXTRACTORS.items() if entry.pair_matcher]


def goes_with(detector: str, extractor: str) -> bool:
    alone = EXTRACTORS[extractor].own_keypoints or {detector, extractor} <= LEARNED
    return detector == extractor or not alone


PAIRS = [pair for pair in itertools.product(DETECTORS, EXTRACTORS) if goes_with(*pair)]
ALL = [(method, *pair, matcher) for method in ("vote", "verified") for pair in PAIRS for matcher in MATCHERS]


def works(method: Method, extractor: str, matcher: str) -> bool:
    return matcher in FITTING[extractor] and (method == "verified" or matcher not in ("ivf", "vlad"))


@pytest.mark.parametrize(
    ("method", "detector", "extractor", "matcher"), [c for c in ALL if works(c[0], *c[2:])]
)
def test_combinations_that_work(method, detector, extractor, matcher):
    choice = choose(method, detector=detector, extractor=extractor, matcher=matcher)
    assert (choice.detector, choice.matcher) == (detector, matcher)
    # Hamming2 counts differing pairs of bits, so ORB computes pairs for it.
    assert choice.extractor == ("orb-wta4" if matcher == "hamming2" else extractor)


@pytest.mark.parametrize(
    ("method", "detector", "extractor", "matcher"), [c for c in ALL if not works(c[0], *c[2:])]
)
def test_combinations_that_cannot_work_are_refused_with_those_that_can(method, detector, extractor, matcher):
    with pytest.raises(UsageError) as refused:
        choose(method, detector=detector, extractor=extractor, matcher=matcher)
    assert refused.value.where == "--matcher"
    assert refused.value.hint is not None
    offered = refused.value.hint.split("work: ")[1].split(", ")
    assert offered
    assert set(offered) == {m for m in FITTING[extractor] if works(method, extractor, m)}
    for name in offered:
        assert choose(method, detector=detector, extractor=extractor, matcher=name).matcher == name


@pytest.mark.parametrize("method", ("vote", "verified"))
@pytest.mark.parametrize("features", ["auto", *BUNDLES])
def test_every_bundle_has_a_matcher_for_every_method(method, features):
    choice = choose(method, features=features)
    assert choice.name == ("sift" if features == "auto" else features)


@pytest.mark.parametrize("method", ("vote", "verified"))
@pytest.mark.parametrize(("detector", "extractor"), PAIRS)
def test_every_pair_has_a_usual_matcher(method, detector, extractor):
    choice = choose(method, detector=detector, extractor=extractor)
    assert works(method, choice.extractor, choice.matcher)
    assert (choice.detector, choice.extractor) == (detector, extractor)


def test_names_in_any_case_and_as_in_opencv():
    assert choose("vote", features="SIFT", matcher="FlannBased").matcher == "flann"
    assert choose("vote", features="Sift", matcher="BruteForce").matcher == "l2"
    assert choose("vote", features="SIFT", matcher="BruteForce-L1").matcher == "l1"
    assert choose("vote", features="ORB", matcher="BruteForce-Hamming").matcher == "hamming"
    assert choose("vote", features="orb", matcher="BruteForce-Hamming(2)").matcher == "hamming2"
    assert choose("vote", features="orb", matcher="Hamming2").matcher == "hamming2"
    assert choose("vote", detector=" ORB ", extractor="RootSIFT", matcher="L2").name == "orb+sift"


def test_one_part_alone_brings_the_fitting_other():
    assert choose("vote", detector="orb").name == "orb"
    assert choose("vote", extractor="orb").name == "orb"
    assert choose("vote", extractor="sift-plain").detector == "sift"
    assert choose("vote", features="sift", detector="orb").name == "orb+sift"
    assert choose("vote", features="orb", extractor="sift").name == "orb+sift"


@pytest.mark.parametrize(
    ("part", "known"),
    [
        ("features", "auto, sift"),
        ("detector", "sift, surf, orb"),
        ("extractor", "sift-plain"),
        ("matcher", "flann"),
    ],
)
def test_unknown_names_are_reported_with_the_known_ones(part, known):
    with pytest.raises(UsageError, match="brisk") as refused:
        choose("vote", **{part: "brisk"})
    assert refused.value.where == f"--{part}"
    assert known in str(refused.value.hint)


def test_a_matcher_of_other_descriptors_names_the_features_for_it():
    with pytest.raises(UsageError, match="--features orb") as refused:
        choose("vote", matcher="hamming")
    assert "flann, l1, l2" in str(refused.value)


def test_what_needs_a_model_and_what_has_no_orientation():
    needs = {name: choose("verified", features=name).model for name in BUNDLES}
    assert needs == {name: name if name in LEARNED else None for name in BUNDLES}
    assert choose("verified", detector="xfeat", extractor="sift").model == "xfeat"
    assert choose("verified", detector="disk", extractor="orb").model == "disk"
    oriented = {name: choose("verified", features=name).oriented for name in BUNDLES}
    assert all(oriented[name] for name in ("sift", "sift-plain", "surf", "orb"))
    assert not any(oriented[name] for name in ("xfeat", "aliked", "disk"))
    assert choose("verified", detector="sift", extractor="xfeat").oriented


@pytest.mark.parametrize(
    ("detector", "extractor"), [p for p in itertools.product(DETECTORS, EXTRACTORS) if not goes_with(*p)]
)
def test_what_describes_its_own_keypoints_only_and_two_models_are_refused(detector, extractor):
    with pytest.raises(UsageError, match=f"{detector}") as refused:
        choose("verified", detector=detector, extractor=extractor)
    assert refused.value.where == "--extractor"
    for words in refused.value.hint.removeprefix("use ").split(" or "):
        choose("verified", features=words.removeprefix("--features "))
    with pytest.raises(UsageError):
        choose("vote", features=detector, extractor=extractor)


def test_descriptors_of_learned_features_have_their_width():
    assert [choose("vote", features=name).width for name in ("xfeat", "aliked", "disk")] == [64, 128, 128]


def test_thorough_takes_features_that_a_network_matches():
    assert choose("thorough").name == "xfeat"
    assert choose("thorough", features="aliked", matcher="vlad").matcher == "vlad"


@pytest.mark.parametrize("features", sorted(BUNDLES.keys() - {*MATCHED}))
def test_thorough_refuses_others_and_says_which_do(features):
    with pytest.raises(UsageError, match="thorough") as refused:
        choose("thorough", features=features)
    assert refused.value.where == "--features"
    assert refused.value.hint == f"use --features {' or '.join(MATCHED)}"


def test_thorough_refuses_features_of_two_kinds():
    with pytest.raises(UsageError, match=r"sift\+xfeat"):
        choose("thorough", detector="sift", extractor="xfeat")
