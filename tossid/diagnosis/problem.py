"""What a diagnosis is of: tosses, a simulator, and the effects that may explain where they differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from tossid.diagnosis.likelihood.engine_discrepancy import Engine
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.sessions.heights import ending_at_origin
from tossid.diagnosis.under_way import UnderWay
from tossid.physics.effects import LIBRARY, Effect, World
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.types import RecordingOrder, Toss


@dataclass(frozen=True)
class Problem:
    """Tosses and a simulator that are compared, and how.

    Attributes:
        tosses: Recorded motions of one object; the covariances of their poses are the noise.
        world: The simulator.
        library: The effects to choose from.
        engine: The other engine, whose differences are no evidence; near-rigid MuJoCo if None.
        n_threads: Of simulators.
        seed: Of the folds and of simulated noise.
        unseen: Other tosses of the same recording, which take no part and are judged in one pass at the end.
        names: Of all these tosses in the order of their recording; empty: as they are given, the unseen ones last.
        sessions: Names of the first tosses of sessions that the dataset has, but for the first.
        own_heights: Whether the tosses' heights were set one by one (`sessions.heights`).
        under_way: Told what is known as soon as it is.
        settings: Of everything else. Its `seed` and `threads` are not read here.
    """

    tosses: Sequence[Toss]
    world: World
    library: Sequence[Effect] = LIBRARY
    engine: Engine | None = None
    n_threads: int = 1
    seed: int = 0
    unseen: Sequence[Toss] = ()
    names: Sequence[str] = ()
    sessions: Sequence[str] = ()
    own_heights: bool = False
    under_way: UnderWay = field(default_factory=UnderWay)
    settings: DiagnoseSettings = field(default_factory=DiagnoseSettings)

    def of(self, tosses: Sequence[Toss], unseen: Sequence[Toss] = ()) -> Problem:
        """The same problem of other tosses.

        Args:
            tosses: That take part.
            unseen: That take none.
        """
        return replace(self, tosses=tosses, unseen=unseen)

    def in_order(self) -> Problem:
        """The same problem with the tosses in the order of their recording."""
        names = self.names or [toss.name for toss in (*self.tosses, *self.unseen)]
        place = {name: i for i, name in enumerate(names)}
        tosses = tuple(sorted(self.tosses, key=lambda toss: place[toss.name]))
        return replace(self, tosses=tosses, names=tuple(names))

    def validator(self, *, over_order: bool = False) -> CrossValidator:
        """What fits hypotheses to the tosses and judges them.

        Args:
            over_order: As of `CrossValidator.of`. Tosses with heights of their own then all end at one place.
        """
        return CrossValidator.of(
            ending_at_origin(self.tosses, self.world.object) if over_order and self.own_heights else self.tosses,
            self.world.object,
            seed=self.seed,
            n_threads=self.n_threads,
            engine=self.engine,
            over_order=over_order,
            settings=self.settings,
        )


def session_starts(order: RecordingOrder | None) -> tuple[str, ...]:
    """Names of the first tosses of a dataset's sessions, but for the first.

    Args:
        order: Of the dataset, None where it was not looked at.
    """
    return () if order is None else tuple(session.first for session in order.sessions[1:])
