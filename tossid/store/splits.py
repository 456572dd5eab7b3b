"""Which tosses train a model, which stop its training, which judge it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from tossid.errors import InputError
from tossid.store.hashing import natural_key
from tossid.types import SPLITS, Toss


def draw_splits(tosses: Sequence[Toss], *, fractions: Sequence[float] = (0.5, 0.3, 0.2), seed: int) -> tuple[Toss, ...]:
    """`drawn_splits` of tosses; they come back in their order, labelled."""
    split = drawn_splits([toss.name for toss in tosses], fractions=fractions, seed=seed)
    return tuple(replace(toss, split=split[toss.name]) for toss in tosses)


def drawn_splits(
    names: Sequence[str],
    *,
    fractions: Sequence[float] = (0.5, 0.3, 0.2),
    seed: int,
    copies: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Draw train, validation and test by toss: each name's split.

    The draw depends on the tosses' names and the seed only, not on their
    order. Counts are the fractions' by largest remainder; with three tosses or
    more no split of a positive fraction is empty. Copies are moved after the
    draw, so that all other tosses stay where they are without them.

    Args:
        names: The tosses' names, no two alike.
        fractions: Of train, validation and test; not negative, with sum 1.
        seed: Of the draw.
        copies: The toss that each copy is of, by the copy's name; a copy goes to the split of that toss.

    Raises:
        InputError: The fractions or the names will not do.
    """
    share = np.asarray(fractions, dtype=float)
    if share.shape != (3,) or not np.isfinite(share).all() or (share < 0).any() or abs(share.sum() - 1) > 1e-6:
        raise InputError(f"split fractions are {list(fractions)}, expected three that are not negative, with sum 1")
    names = sorted(names, key=natural_key)
    if len(set(names)) < len(names):
        twice = next(a for a, b in pairwise(names) if a == b)
        raise InputError(f"two tosses are named {twice!r}; names must differ to draw splits")
    count = _counts(share, len(names))
    drawn = np.random.default_rng(seed).permutation(len(names))
    label = np.repeat(SPLITS, count)
    split = {names[index]: str(label[place]) for place, index in enumerate(drawn)}
    # (where the original is not among the names, the first of its copies stands for it)
    stays = dict[str, str]()
    for name in names:
        original = (copies or {}).get(name, name)
        stays.setdefault(original, original if original in split else name)
    return {name: split[stays[(copies or {}).get(name, name)]] for name in split}


def _counts(share: np.ndarray, n: int) -> np.ndarray:
    # the largest remainders get what rounding down leaves over (Hamilton's method)
    exact = share * n
    count = np.floor(exact).astype(int)
    for place in np.argsort(-(exact - count), kind="stable")[: n - count.sum()]:
        count[place] += 1
    if n >= 3:
        for place in np.flatnonzero((count == 0) & (share > 0)):
            count[np.argmax(count)] -= 1
            count[place] += 1
    return count
