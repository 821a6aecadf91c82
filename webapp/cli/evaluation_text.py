"""An evaluation as text for the terminal."""

from __future__ import annotations

from webapp.render.report import figures
from webapp.tasks.localize.evaluation_types import Evaluation


def summary_table(evaluation: Evaluation) -> str:
    """Write the figures as a table: what, value, 95 % interval.

    Parameters
    ----------
    evaluation : Evaluation

    Returns
    -------
    str
        Lines without a line end after the last.
    """
    lines = figures(evaluation)
    words, value = (
        max(len(text) for text in texts) for texts in ([f.words for f in lines], [f.value for f in lines])
    )
    body = [f"{f.words:<{words}}  {f.value:>{value}}  {f.interval}".rstrip() for f in lines]
    return "\n".join([heading(evaluation), "", *body])


def heading(evaluation: Evaluation) -> str:
    """Say in a line what was evaluated."""
    subject = evaluation.subject
    asked = {
        "queries": f"{evaluation.summary.queries} queries",
        "leave-one-out": f"{evaluation.summary.queries} of its own photos, each hidden",
        "leave-one-place-out": f"{evaluation.summary.queries} of its own photos, "
        f"all within {evaluation.hide_within_px or 0:.0f} px hidden",
    }[evaluation.scheme]
    photos = len(subject.map.experiences)
    return f"{subject.method}, {subject.features}: map of {photos} photos, {asked}"
