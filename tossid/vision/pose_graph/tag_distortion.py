"""How tags differ from flat squares with sharp edges, estimated from the residuals.

Two effects are estimated. A bright surround spreads into a tag's black border, or the border into the surround: all
edges of a tag move outward or inward together, by another amount in each image. And a print is stretched by a percent
or not flat: a tag's corners are off in the same way in every image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.vision.pose_graph.factors import IDEAL_TAGS, TagModel
from tossid.vision.pose_graph.reprojection import ReprojectionErrors
from tossid.vision.pose_graph.scene import Scene

Bools = NDArray[np.bool_]

FEWEST_SIGHTINGS, FEWEST_STEPS = 50, 20
"""Sightings from which a spread of edges is estimated, and time steps that must show a tag before its print is."""
VARIANCE_RATIO = 2.0
"""The spread's variance must be this many times what independent errors of corners give."""
CONVERGED = 0.1
"""The estimate has converged when the spread changes by less than this share."""
CHI2_MEDIAN_1, CHI2_MEDIAN_7 = 0.455, 6.35
"""Medians of χ² with one and with seven degrees of freedom."""


def estimate_tag_model(
    scene: Scene,
    errors: ReprojectionErrors,
    used: Bools,
    before: TagModel = IDEAL_TAGS,
) -> TagModel:
    """The spread of tags' edges, and which tags' prints to estimate; `IDEAL_TAGS` where the residuals show no spread.

    The variance of the spread is the likeliest one by expectation maximisation, from the second call on.

    Args:
        scene: The sightings.
        errors: Reprojection under poses that were found with `before`.
        used: Sightings to use, (d,).
        before: The estimate so far.
    """
    steps = np.bincount(scene.step[used], minlength=len(scene.t))
    good = used & np.isfinite(errors.whitened) & (steps[scene.step] > 1)
    if good.sum() < FEWEST_SIGHTINGS:
        return IDEAL_TAGS
    # without the spread, seven of a sighting's eight residuals are left
    b, certainty = errors.spread[good], errors.spread_certainty[good]
    left = 8 * errors.raw_whitened[good] ** 2 - (certainty * b) ** 2
    noise2 = float(np.median(left)) / CHI2_MEDIAN_7
    if before.spread_sigma:  # E step: b is Gaussian with mean share · b and variance rest
        share = before.spread_sigma**2 * certainty**2 / (1 + before.spread_sigma**2 * certainty**2)
        rest = share * noise2 / certainty**2
        sigma2 = (float(np.median((share * b) ** 2)) / CHI2_MEDIAN_1 + float(np.median(rest))) / noise2
    else:
        by_noise = noise2 / float(np.median(certainty**2))
        spread2 = float(np.median(b**2)) / CHI2_MEDIAN_1
        sigma2 = (spread2 - by_noise) / noise2 if spread2 > VARIANCE_RATIO * by_noise else 0.0
    return TagModel(float(np.sqrt(sigma2)), _prints(scene, used))


def converged(before: TagModel, after: TagModel) -> bool:
    """Whether two estimates hardly differ."""
    change = abs(after.spread_sigma - before.spread_sigma)
    return before.prints == after.prints and change <= CONVERGED * after.spread_sigma


def _prints(scene: Scene, used: Bools) -> frozenset[int]:
    """Tags whose poses are known no better than their prints, and that are seen often."""
    found = set()
    for i, tag in enumerate(scene.tags):
        vague = tag.T_body_tag is None or (tag.position_noise is not None and tag.position_noise.min() > tag.size / 2)
        if vague and len(np.unique(scene.step[used & (scene.tag == i)])) >= FEWEST_STEPS:
            found.add(i)
    return frozenset(found)
