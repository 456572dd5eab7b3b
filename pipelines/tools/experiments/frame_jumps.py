"""Body frames that jump between tosses of the published cube, and how far tosses then rest off the ground."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded

if TYPE_CHECKING:
    from tossid.types import Toss

TOSSES = 64
JUMPS = (
    ("none", 0, (0.0, 0.0, 0.0), 0.0),
    ("12 mm along x", 32, (0.012, 0.0, 0.0), 0.0),
    ("5 mm along y", 32, (0.0, 0.005, 0.0), 0.0),
    ("12 mm along x", 3, (0.012, 0.0, 0.0), 0.0),
    ("10 degrees about y", 32, (0.0, 0.0, 0.0), 10.0),
    ("90 degrees about y", 32, (0.0, 0.0, 0.0), 90.0),
)
"""What happens to the body frame, for the last so many tosses: a shift [m], and a turn about y [deg]."""


def main(folder: Path) -> None:
    """Print a Markdown row for each jump.

    Args:
        folder: Holds contactnets_cube.
    """
    import numpy as np

    import tossid
    from tossid.objects import unstated_object
    from tossid.objects.convex_shape import find_shape
    from tossid.settings.objects import UnknownObjectSettings
    from tossid.training.unknown import rest_heights

    console, dataset = Console(), tossid.ingest(folder / "contactnets_cube", source="contactnets")
    tosses, limit = list(dataset.of_split("train"))[:TOSSES], UnknownObjectSettings().rest_off_rel
    console.say("| jump | tosses | found as | at rest | farthest off [mm] | beyond the limit |")
    console.say("|---|---|---|---|---|---|")
    for name, count, shift, degrees in JUMPS:
        jumped = [moved(toss, shift, degrees) if i >= TOSSES - count else toss for i, toss in enumerate(tosses)]
        shape = find_shape(jumped)
        height = np.abs(list(rest_heights(jumped, unstated_object(), [shape]).values()))
        beyond = int((height > limit * shape.mean_width).sum())
        cells = [name, f"{count}", shape.kind, f"{len(height)}", f"{1e3 * height.max():.1f}", f"{beyond}"]
        console.say("| " + " | ".join(cells) + " |")


def moved(toss: Toss, shift: tuple[float, float, float], degrees: float) -> Toss:
    """The toss as recorded in another body frame.

    Args:
        toss: As recorded.
        shift: Of the frame, in its axes [m].
        degrees: Its turn about its y axis.
    """
    import numpy as np

    from tossid.rotations import quat_exp, quat_mul, quat_rotate

    q = toss.q.copy()
    q[:, :3] += quat_rotate(q[:, 3:7], np.array(shift))
    q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(np.array([0.0, np.deg2rad(degrees), 0.0])))
    return replace(toss, q=q)


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1])), "frame_jumps"))
