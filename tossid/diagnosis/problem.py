"""What a diagnosis is of: tosses, a simulator, and the effects that may explain where they differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from tossid.diagnosis.inference.hypothesis import ContactLaw, Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.diagnosis.under_way import UnderWay
from tossid.motion.resting import rest_scatter
from tossid.physics.effects import LIBRARY, Effect
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.types import Toss


@dataclass(frozen=True)
class Problem:
    """Tosses and a simulator that are compared, and how.

    Attributes:
        tosses: Recorded motions of one object; the covariances of their poses are the noise.
        stated: The simulator, without effects, under its own law of contact.
        laws: Of contact, that the tosses may follow instead.
        library: The effects to choose from.
        n_threads: Of simulators.
        seed: Of the folds and of simulated noise.
        unseen: Other tosses of the same recording, which take no part and are judged in one pass at the end.
        names: Of all these tosses in the order of their recording; empty: as they are given, the unseen ones last.
        sessions: Names of the first tosses of sessions that the dataset has, but for the first.
        under_way: Told what is known as soon as it is.
        settings: Of everything else. Its `seed` and `threads` are not read here.
    """

    tosses: Sequence[Toss]
    stated: Hypothesis
    laws: tuple[ContactLaw, ...] = ()
    library: tuple[Effect, ...] = LIBRARY
    n_threads: int = 1
    seed: int = 0
    unseen: Sequence[Toss] = ()
    names: Sequence[str] = ()
    sessions: Sequence[str] = ()
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

    @cached_property
    def sample(self) -> Sample:
        """The windows of the tosses; a tracker's slow errors are as their own poses at rest scatter."""
        return Sample(self.windows_of(self.tosses, self.tosses), len(self.tosses), self.n_threads)

    def windows_of(self, tosses: Sequence[Toss], scattered: Sequence[Toss], *, shift: float = 0.0) -> Windows:
        """Windows of tosses.

        Args:
            tosses: The tosses.
            scattered: Those whose poses at rest show a tracker's slow errors, in the order of recording: what changes
                over it is none.
            shift: By what share of their length windows begin later.
        """
        model, likelihood = self.stated.base.object, self.settings.likelihood
        scatter = rest_scatter(scattered, model, over_order=True)
        frames = round(shift * likelihood.windows.length)
        return make_windows(tosses, model, settings=likelihood, scatter=scatter, shift=frames)

    def shifted(self, share: float) -> Sample:
        """The same tosses in windows that begin elsewhere.

        Args:
            share: Of a window's length.
        """
        windows = self.windows_of(self.tosses, self.tosses, shift=share)
        return Sample(windows, len(self.tosses), self.n_threads)

    def search(self) -> Search:
        """The search over all tosses."""
        watch = self.under_way.watched
        return Search(self.sample, self.library, self.stated, self.laws, seed=self.seed, watch=watch)
