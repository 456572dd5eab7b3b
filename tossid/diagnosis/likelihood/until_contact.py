"""The part of windows before contact: what determines a first state without any impact.

A window with a landing has some frames of flight before it. Over all its frames the posterior of the first state has
several modes, as another impact follows from a slightly other state. Over the frames of flight it has one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.windows import Windows
from tossid.types import Phase

FEWEST_FRAMES = 4
"""Frames of flight that determine a first state."""
MARGIN = 2
"""Frames before the recorded landing that are left out: the simulator's may be earlier."""


def until_contact(windows: Windows) -> tuple[NDArray[np.int64], Windows]:
    """The windows that begin in flight and go on in contact, cut off before it.

    Args:
        windows: Any; each row of one with contact is a frame.

    Returns:
        Their numbers (n,), and themselves.
    """
    W, L = windows.inside.shape
    flying = np.append((windows.phase == Phase.FLIGHT) & windows.inside, np.zeros((W, 1), dtype=bool), axis=1)
    frames = flying.argmin(axis=1) - MARGIN
    landing = (frames >= FEWEST_FRAMES) & (frames + MARGIN < windows.inside.sum(axis=1)) & ~windows.steady
    index = np.flatnonzero(landing)
    some, frames = windows.rows(index), frames[index]
    later = np.arange(L) >= frames[:, None]
    beyond = np.append(np.zeros((len(index), 1), dtype=bool), later, axis=1)
    return index, replace(
        some,
        steps=frames,
        mix=np.where(later[..., None], 0.0, some.mix),
        inside=some.inside & ~later,
        noise=np.where(later[..., None], 1.0, some.noise),
        # rows beyond are nobody's: neither residuals nor the errors of earlier rows enter them
        root=np.where(beyond[:, None, :, None], np.eye(L + 1), some.root),
    )
