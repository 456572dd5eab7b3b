"""The report's sentences on a diagnosis that was interrupted."""

from __future__ import annotations

from tossid.diagnosis.report.units import listed
from tossid.diagnosis.result import Diagnosis


def interruption_sentences(diagnosis: Diagnosis) -> list[str]:
    """Where a diagnosis was interrupted, and what was suspected; nothing for a complete one.

    Args:
        diagnosis: What is known.
    """
    stopped = diagnosis.interruption
    if stopped is None:
        return []
    text = f"The diagnosis was interrupted ({stopped.stage}). "
    if diagnosis.verdict != "incomplete":
        return [text + "The search had ended. The next toss and the patched model are missing."]
    text += "What follows is what was known by then. Nothing is said of effects that are not listed."
    if stopped.suspects:
        names = [name for name, _ in stopped.suspects]
        text += f" By one step toward each, the leading suspect is {names[0]}"
        text += f", before {listed(names[1:])}." if names[1:] else "."
    return [text]
