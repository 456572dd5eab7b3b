"""Settings of a diagnosis over the order of recording (`tossid.diagnosis.sessions`)."""

from __future__ import annotations

from dataclasses import dataclass

from tossid.settings.kinds import Count, Fraction, Positive
from tossid.settings.sessions import SessionSettings


@dataclass(frozen=True, kw_only=True)
class OrderSettings:
    """When an effect is not the same in all tosses, and which effect that is."""

    significance: Fraction = 0.005
    """probability of finding any change of any effect in tosses whose order means nothing; and of values that differ as
    much between stretches, by the scatter of tosses"""
    permutations: Count = 19999
    """orders of the tosses that are drawn to test a change; so many that one of thirty effects can be significant"""
    first_permutations: Count = 199
    """of these first; the others only where a change may be significant"""
    fewest_tosses: Count = 5
    """tosses that a session has at least"""
    outlier: Positive = 3.0
    """standard deviations beyond which a toss counts no more than one at this distance"""
    seed: Count = 1
    """of the orders that are drawn"""
    rounds: Count = 3
    """most effects that change one beside the other"""
    candidates: Count = 5
    """effects that are fitted, stretch by stretch"""
    from_starts: Count = 2
    """effects that are fitted from declared starts where none of those gains anything"""
    comparable: Fraction = 0.5
    """share of the best gain of a change over its mean from which on another effect may be what changes"""
    least_gain: Positive = 30.0
    """gain of log-likelihood that a change of an effect must bring"""
    indistinguishable: Fraction = 0.1
    """share of the best gain of log-likelihood by which another effect's may be less and count as the same; of such
    effects, one of the recording is preferred"""
    special: Fraction = 0.75
    """share of an effect's gain of log-likelihood from which on a special case of it is preferred"""
    largest_move: Count = 6
    """tosses by which the moment of a step is moved at most to where it is likeliest"""
    unchanging: Fraction = 0.5
    """share of the best gain of log-likelihood from which on another effect is preferred to a change of the object or
    of gravity, which stay the same from toss to toss"""
    same_change: Count = 3
    """tosses between a change and one between sessions of the dataset within which both are one"""

    @property
    def changes(self) -> SessionSettings:
        """How changes over an order are found and tested."""
        return SessionSettings(
            significance=self.significance,
            permutations=self.permutations,
            first_permutations=self.first_permutations,
            fewest_tosses=self.fewest_tosses,
            outlier=self.outlier,
            seed=self.seed,
        )
