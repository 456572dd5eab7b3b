"""Whether tosses contradict the stated size of an object.

A body that stands on its lowest face shows its height. Recorded height over stated height is either a wrong stated size
or a wrong unit of the recording: tosses cannot tell which.
"""

from __future__ import annotations

from typing import Any

from tossid.motion import MeasurementEstimate, MeasurementModel
from tossid.motion.measurement import FEWEST_TOSSES, SIZE_WARNING


def size_contradiction(found: MeasurementEstimate, used: MeasurementModel) -> dict[str, Any] | None:
    """What tosses at rest say against the stated size.

    Args:
        found: Of the training tosses, with the stated object.
        used: How the model takes recorded motion.

    Returns:
        {"shown_over_stated", "ci95", "n_at_rest", "length_scale", "warning": text}; None where too few tosses stand
        still, where the interval holds 1, or where the difference is within the limit.
    """
    scale, low, high = (float(x) for x in (found.length_scale, *found.length_scale_ci95))
    if found.n_at_rest < FEWEST_TOSSES or abs(scale - 1) <= SIZE_WARNING or low <= 1 <= high:
        return None
    change = f"{100 * abs(scale - 1):.1f} % {'larger' if scale > 1 else 'smaller'}"
    ends = " to ".join(f"{end:.4f}" for end in (low, high))
    taken = (
        "the model takes recorded lengths as they are, and the learned corners take it up"
        if used.length_scale == 1.0
        else f"the model divides recorded lengths by {used.length_scale:.4f}; with model.length_scale=1 the learned "
        "corners take it up"
    )
    return {
        "shown_over_stated": scale,
        "ci95": [low, high],
        "n_at_rest": found.n_at_rest,
        "length_scale": used.length_scale,
        "warning": f"{found.n_at_rest} tosses at rest show the object {change} than stated (ratio {scale:.4f}, 95 % "
        f"interval {ends}): a wrong stated size, or a wrong unit of the recording; {taken}",
    }
