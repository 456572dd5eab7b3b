"""Where a cube touches the ground, by its resting poses and by its impacts on a lone corner, without a simulator.

    python -m pipelines.tools.experiments.by_hand.heights FILE.h5 [--split train]
                                                          [--effects '{"com_offset": {"z_m": 0.0055}}']

The first table has the height of the centre above z = 0 at rest, by the face that lies below (least squares with one
plane for all), and how the ground slopes by these heights and by the resting attitudes. The second has how far below
z = 0 the lowest corner of the cube with the effects would be at impacts on a lone corner, by how steeply it stands. A
sharp corner of the right size is at 0 whatever its attitude. One with a radius r is short of that by r (s - 1), with s
the sum of the vertical's components along the cube's axes. The effects say where the centre of mass is, how large the
cube is, and how the ground lies.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import theilslopes

from pipelines.tools.experiments.by_hand.given import arguments, asked
from tossid.diagnosis.localisation.witnesses import Impacts, lone_impacts
from tossid.objects import ObjectModel
from tossid.rotations import quat_to_matrix
from tossid.types import Toss

Array = NDArray[np.float64]
LAST, STILL = 4, 5e-4
"""Frames at a toss's end that are at rest if the height changes by no more in them [m]."""
STEEPNESS = (1.0, 1.4, 1.55, 1.65, 1.74)
"""Ends of the ranges of s."""


def resting(tosses: Sequence[Toss]) -> tuple[str, ...]:
    """Rows of the first table, in Markdown.

    Args:
        tosses: Of a cube.
    """
    places, faces, normals = [], [], []
    for toss in tosses:
        q = toss.measured[0][-LAST:]
        if np.ptp(q[:, 2]) > STILL:
            continue
        turned = quat_to_matrix(q[-1, 3:])
        axis = int(np.abs(turned[2]).argmax())
        up = np.sign(turned[2, axis])
        places.append(q.mean(axis=0)[:3])
        faces.append(2 * axis + int(up > 0))
        normals.append(up * turned[:2, axis])
    at, found = np.array(places), np.unique(faces)
    lies = (np.array(faces)[:, None] == found).astype(float)
    A = np.concatenate([at[:, :2], lies], axis=1)
    solution, _, _, _ = np.linalg.lstsq(A, at[:, 2], rcond=None)
    left = at[:, 2] - A @ solution
    sizes = np.sqrt(np.diagonal(np.linalg.inv(A.T @ A)) * left.var())
    heights = ", ".join(f"{1e3 * x:.2f}" for x in solution[2:])
    slopes = ", ".join(f"{1e3 * x:.1f} ± {1e3 * size:.1f}" for x, size in zip(solution[:2], sizes[:2], strict=True))
    leans = ", ".join(f"{-1e3 * x:.1f}" for x in np.median(normals, axis=0))
    return (
        f"| tosses at rest | {len(at)} |",
        f"| height of the centre, by face [mm] | {heights} |",
        f"| left of heights [mm] | {1e3 * left.std():.2f} |",
        f"| slope of the ground by heights, along x and y [mrad] | {slopes} |",
        f"| slope by attitudes (medians) [mrad] | {leans} |",
    )


def depths(hit: Impacts, model: ObjectModel) -> tuple[Array, Array]:
    """(n,) depth of the lowest corner below z = 0 [m], and s, at impacts.

    Args:
        hit: Impacts.
        model: The cube.
    """
    up = quat_to_matrix(hit.q)[:, 2]
    lowest = (up @ (model.corner_pos - model.com[0]).T).min(axis=1)
    return -(hit.height + lowest), np.abs(up).sum(axis=1)


def struck(depth: Array, steepness: Array) -> tuple[str, ...]:
    """Rows of the second table, in Markdown, and the radius that fits.

    Args:
        depth: As of `depths`.
        steepness: The same.
    """
    rows = []
    for low, high in itertools.pairwise(STEEPNESS):
        some = depth[(steepness >= low) & (steepness < high)]
        if len(some):
            rows.append(f"| {low:g} to {high:g} | {len(some)} | {1e3 * np.median(some):.2f} | {1e3 * some.std():.2f} |")
    # a median of slopes: where another corner was struck than the lowest one, depths are off by millimetres
    radius, base, low, high = theilslopes(depth, steepness - 1)
    left = 1e3 * np.median(np.abs(depth - base - radius * (steepness - 1)))
    rows.append(
        f"\nradius {1e3 * radius:.1f} mm ({1e3 * low:.1f} to {1e3 * high:.1f}), and {1e3 * base:.1f} mm at s = 1 "
        f"(Theil and Sen); {left:.2f} mm are left (median)"
    )
    return tuple(rows)


def main() -> None:
    """Print both tables."""
    _, tosses, world = asked(arguments(__doc__).parse_args())
    hit = lone_impacts(tosses, world)
    print("\n".join(("| at rest | |\n|---|---|", *resting(tosses))))  # noqa: T201
    print("\n| s | impacts | depth of the lowest corner [mm] | spread [mm] |\n|---|---|---|---|")  # noqa: T201
    print("\n".join(struck(*depths(hit, world.object))))  # noqa: T201


if __name__ == "__main__":
    main()
