"""The figure of the recording itself: what tosses say of their world, over the order of recording and over place."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from tossid.diagnosis.report.registry import report_figure
from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.sessions import recording_over_order
from tossid.motion.sessions import session_words
from tossid.settings.diagnosis_report import ReportSettings


def session_paragraphs(diagnosis: Diagnosis) -> Sequence[str]:
    """A sentence for each session, and the notes on the order of recording.

    Args:
        diagnosis: What was found.
    """
    if diagnosis.order is None:
        return ()
    said = [f"Session {session_words(session)}." for session in diagnosis.order.sessions]
    return [*said, *(f"{note[0].upper()}{note[1:]}." for note in diagnosis.order.notes)]


@report_figure(
    "gap_recording",
    alt="Gravity, resting faces, contact and heights of single tosses, over the order of recording and over place.",
    detail="The recording: sessions, and what changes with place",
    text=session_paragraphs,
    note="Each point is a toss, as it was recorded. Vertical lines divide sessions: changes that at most one in two "
    "hundred random orders of the tosses would show, corrected for the number of quantities.",
    applies=lambda diagnosis: diagnosis.order is not None and len(diagnosis.order.names) > 1,
)
def recording(diagnosis: Diagnosis, settings: ReportSettings) -> Figure:
    """What single tosses say of their recording.

    Args:
        diagnosis: What was found.
        settings: What the figures draw.

    Returns:
        The figure.
    """
    assert diagnosis.order is not None
    return recording_over_order(diagnosis.order)
