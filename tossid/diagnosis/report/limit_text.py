"""Whether a verdict hangs on a limit that tosses do not decide."""

from __future__ import annotations

from tossid.diagnosis.result import Diagnosis


def limit_sentences(diagnosis: Diagnosis) -> list[str]:
    """That the limit of "partly explained" lies within the interval of the share that is closed.

    Where whole tosses refuse all effects, the gap is not explained, whatever share of short windows is closed.

    Args:
        diagnosis: What was found.
    """
    closed, limit = diagnosis.gap_closed, diagnosis.stability.least_closed
    refused = diagnosis.rollouts is not None and diagnosis.rollouts.whole.refused
    if (
        refused
        or diagnosis.verdict not in ("partly_explained", "unexplained")
        or not closed.low <= limit <= closed.high
    ):
        return []
    return [
        f"A gap is partly explained from {100 * limit:.0f} % on. This lies within the interval, so that as many other "
        "tosses of the same kind may lead to the other verdict: 'partly explained' or 'not explained'."
    ]
