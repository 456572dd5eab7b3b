"""The first frames of windows, over which first states are found before later frames take part.

Over all frames of a window with contact, the posterior of its first state has several modes: after a slightly other
state, another impact follows. Over the first few frames it has one. From there the mode is followed while frames are
added, as in continuation (Allgower and Georg, "Numerical Continuation Methods", 1990).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tossid.diagnosis.likelihood.windows import Windows


def first_frames(windows: Windows, share: float) -> Windows:
    """The windows with their first frames only.

    Args:
        windows: Any, but for long ones, in which a row is more than a frame (`Windows.steady`).
        share: Of the frames of each that are left, rounded up.
    """
    (W, L), F = windows.inside.shape, windows.mix.shape[2]
    rows = np.ceil(share * windows.inside.sum(axis=1)).astype(np.int64)
    later = np.arange(L) >= rows[:, None]
    mix = np.where(later[..., None], 0.0, windows.mix)
    beyond = np.append(np.zeros((W, 1), dtype=bool), later, axis=1)
    return replace(
        windows,
        steps=(np.arange(1, F + 1) * mix.any(axis=1)).max(axis=1),
        mix=mix,
        inside=windows.inside & ~later,
        noise=np.where(later[..., None], 1.0, windows.noise),
        # rows beyond are nobody's: neither residuals nor the errors of earlier rows enter them
        root=np.where(beyond[:, None, :, None], np.eye(L + 1), windows.root),
    )
