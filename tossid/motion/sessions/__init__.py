"""Sessions: stretches of a recording between which a camera was bumped, a table cleaned, a calibration redone.

`witnesses` is what each toss says of its recording, and `change_points` finds where that changes over the order of
recording. `search` makes sessions of it and decides how each is tilted, and `levelling` turns tracks into the level
world and back. `turns` finds recordings that were turned about the vertical after they were tracked, and `copies`
tosses that are there twice.
"""

from __future__ import annotations

from tossid.motion.sessions.levelling import as_recorded, levelled_tracks
from tossid.motion.sessions.search import find_sessions, session_words

__all__ = ["as_recorded", "find_sessions", "levelled_tracks", "session_words"]
