"""What tags' images and prints are off by, as the residuals show it: edges that spread, and squares that are none.

A bright surround eats into a tag's black border or the border bleeds into it, alike all around: corners move outward or
inward together, otherwise in each image. And a printer's two directions differ by up to a percent, labels are stretched
and paper is not flat: then a tag's corners are off in every image in the same way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.vision.factors import NO_FLAWS, Flaws
from tossid.vision.reprojection import Errors
from tossid.vision.scene import Scene

Bools = NDArray[np.bool_]

FEWEST = 50
"""Sightings from which a spread is told."""
STANDS_OUT = 2.0
"""Variance of the edges' spread over that which independent errors of corners give, from which it is taken for real."""
SETTLED = 0.1
"""By how much of itself the spread then still changes."""
OFTEN = 20
"""Time steps that have to show a tag before its print is found."""


def find_flaws(scene: Scene, errors: Errors, used: Bools, flaws: Flaws = NO_FLAWS) -> Flaws:
    """How far edges spread, over the noise's scale, and which tags' prints are to be found.

    Args:
        errors: of poses that were found with `flaws`.
    """
    steps = np.bincount(scene.step[used], minlength=len(scene.t))
    good = used & np.isfinite(errors.whitened) & (steps[scene.step] > 1)
    if good.sum() < FEWEST:
        return NO_FLAWS
    # what is left of a sighting's squares without the spread has seven of its eight components
    b, told = errors.spread[good], errors.told[good]
    left = 8 * errors.bare_whitened[good] ** 2 - (told * b) ** 2
    noise2 = float(np.median(left)) / 6.35
    if flaws.swell:  # the likeliest, by expectation maximisation: b is known to within `rest`
        share = flaws.swell**2 * told**2 / (1 + flaws.swell**2 * told**2)
        rest = share * noise2 / told**2
        swell2 = (float(np.median((share * b) ** 2)) / 0.455 + float(np.median(rest))) / noise2
    else:
        by_noise = noise2 / float(np.median(told**2))
        spread2 = float(np.median(b**2)) / 0.455
        swell2 = (spread2 - by_noise) / noise2 if spread2 > STANDS_OUT * by_noise else 0.0
    return Flaws(float(np.sqrt(swell2)), _printed(scene, used))


def settled(before: Flaws, flaws: Flaws) -> bool:
    """Whether flaws have hardly changed."""
    return before.printed == flaws.printed and abs(flaws.swell - before.swell) <= SETTLED * flaws.swell


def _printed(scene: Scene, used: Bools) -> frozenset[int]:
    """Tags whose own poses are known no better than their print, and that are seen often."""
    found = set()
    for i, tag in enumerate(scene.tags):
        vague = tag.T_body_tag is None or (tag.position_noise is not None and tag.position_noise.min() > tag.size / 2)
        if vague and len(np.unique(scene.step[used & (scene.tag == i)])) >= OFTEN:
            found.add(i)
    return frozenset(found)
