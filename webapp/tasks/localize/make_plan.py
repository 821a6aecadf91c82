"""Plans how a map is opened: which features, matcher and looks a request stands for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from webapp.core.features.table import Method, choose
from webapp.extras import is_installed
from webapp.files.localize.models import second_look_features
from webapp.settings import Settings
from webapp.tasks.localize.index_location import has_landmarks, index_bases, newest_choice
from webapp.tasks.localize.plan import LookPlan, MapPlan, OpenOptions


def make_plan(cfg: Path, options: OpenOptions, *, settings: Settings, newest: bool = False) -> MapPlan:
    """Resolve a request to open a map.

    Args:
        newest: `auto` selects the features of the newest index that can be used, not the default ones.

    Raises:
        UsageError: The combination of features is not possible.
    """
    on_demand = options.method == "landmarks" and not has_landmarks(cfg) and can_reconstruct(settings)
    method: Method = "verified" if on_demand or options.method == "auto" else options.method
    if newest and not on_demand and not options.names_features:
        bases = index_bases(cfg, options.index)
        models, matcher = settings.models, options.matcher
        choice = newest_choice(bases, settings.extract, method=method, matcher=matcher, models=models)
    else:
        choice = options.choose(options.method)
    first = LookPlan(
        method,
        choice,
        keeps_matcher=on_demand or options.matcher is not None,
        is_second=False,
        index=options.index,
        jobs=options.jobs,
        map_fov_deg=options.map_fov_deg,
        right_within_px=options.right_within_px,
        map_kind=options.map_kind,
        build=options.build,
    )
    looks = (first, *_second(options, first, settings))
    return MapPlan(options.method, looks, on_demand, settings.retrieval.budget_s)


def _second(options: OpenOptions, first: LookPlan, settings: Settings) -> tuple[LookPlan, ...]:
    """Plan the second look of `auto`; none with explicitly requested features or without its models."""
    if options.method != "auto" or options.names_features or options.matcher:
        return ()
    features = second_look_features(settings.models)
    if features in (None, first.choice.name) or settings.retrieval.budget_s == 0.0:
        return ()
    return (replace(first, choice=choose(first.method, features=features), is_second=True),)


def can_reconstruct(settings: Settings) -> bool:
    """Return whether the surroundings of a place are reconstructed on demand."""
    return settings.landmarks.around_s > 0.0 and is_installed("sfm")
