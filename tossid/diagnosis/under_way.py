"""What a diagnosis knows while it is under way: reported as it becomes known, and kept for one that is interrupted."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from tossid.diagnosis.localisation.gap import in_short
from tossid.diagnosis.result import Diagnosis
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.physics.effects import Effect
from tossid.types import Progress, Toss, silent

SEARCHED = 0.93
"""Share of the whole that is done with the search and its repeats."""
TIME_OF_REPEAT = 0.3
"""Time of a repeat over that of the search: 0.2 to 0.4 on simulated and on real tosses of the cube."""


@dataclass(frozen=True)
class Suspect:
    """An effect that may explain the gap.

    Attributes:
        effect: The effect.
        gain: Of log-likelihood, by one step.
    """

    effect: Effect
    gain: float


@dataclass(frozen=True)
class SoFar:
    """What is known at a time.

    Attributes:
        tosses: That are searched.
        validator: Of their windows.
        first: The hypothesis without effects.
        present: With the effects that have joined.
        suspects: Effects that may join, the leading one first.
        started: When this became known first (`time.perf_counter`).
    """

    tosses: tuple[Toss, ...]
    validator: CrossValidator
    first: Candidate
    present: Candidate
    suspects: tuple[Suspect, ...] = ()
    started: float = field(default_factory=time.perf_counter)

    @property
    def seconds(self) -> float:
        """How long ago the gap became known [s]."""
        return time.perf_counter() - self.started


class UnderWay:
    """Reports of a diagnosis that is under way. To call it reports progress.

    Attributes:
        stage: What is under way.
        so_far: What is known; None before the gap is.
        ended: What the search before this one had found; None if there was none.
        answer: What the search has concluded, with the repeats that have been made; None before it has.
        repeats: How many repeats of the search follow it.
        progress: Called with what is under way, and the share that is done.
    """

    def __init__(self, progress: Progress = silent, news: Callable[[str], None] | None = None) -> None:
        """Reports to a person.

        Args:
            progress: Called with what is under way, and the share that is done.
            news: Called with a line on what has become known.
        """
        self.stage = ""
        self.answer: Diagnosis | None = None
        self.repeats = 0
        self.so_far: SoFar | None = None
        self.ended: SoFar | None = None
        self.progress, self._news, self._said = progress, news, ""

    def __call__(self, what: str, share: float) -> None:
        """Report what is under way.

        Args:
            what: In a few words.
            share: Of the whole that is done, but for the repeats of the search.
        """
        self.stage = what
        self.progress(what, share if share > SEARCHED else share * self._share_of_search)

    @property
    def _share_of_search(self) -> float:
        """The time of the search as a share of its time and that of its repeats."""
        return 1.0 / (1.0 + TIME_OF_REPEAT * self.repeats)

    def answered(self, made: Diagnosis) -> None:
        """The search has concluded, or has been repeated once more.

        Args:
            made: The diagnosis, with the repeats that have been made.
        """
        self.answer, done = made, len(made.stability.repeats)
        if done == 0:
            found = f"the search names {', '.join(made.found) or 'no effect'}: {made.verdict.replace('_', ' ')}"
            if made.found:
                found += f", {100 * made.gap_closed.value:.0f} % of the gap closed"
            self.say(found + ("; its repeats show how sure that is" if self.repeats else ""))
        if done < self.repeats:
            begin = SEARCHED * self._share_of_search
            self.stage = f"{done} of {self.repeats} repeats of the search made"
            self.progress(self.stage, begin + (SEARCHED - begin) * done / self.repeats)

    @property
    def furthest(self) -> SoFar | None:
        """What is known by the search that has found most effects, by the last one of several that have found as many.

        A search begins anew where tosses are corrected, or more of them taken. Until it has come as far, the one before
        knows more.
        """
        if self.ended is None or self.so_far is None:
            return self.so_far
        return max((self.so_far, self.ended), key=lambda each: len(each.present.hypothesis.effects))

    def begun(
        self, tosses: Sequence[Toss], validator: CrossValidator, first: Candidate, count: int | None = None
    ) -> None:
        """The gap is known.

        Args:
            tosses: That are searched.
            validator: Of their windows.
            first: The hypothesis without effects.
            count: How many tosses there are, if these are the first of them only.
        """
        self.ended = self.furthest
        self.so_far = SoFar(tuple(tosses), validator, first, first)
        self.say(in_short(first) + ("" if count is None else f" (of the first {len(tosses)} of {count} tosses)"))

    def suspected(self, gains: Sequence[tuple[Effect, float]]) -> None:
        """Effects may explain the gap, or what is left of it.

        Args:
            gains: Each with its gain of log-likelihood by one step.
        """
        ordered = sorted((Suspect(effect, gain) for effect, gain in gains if gain > 0), key=lambda each: -each.gain)
        if self.so_far is not None and ordered:
            self.so_far = replace(self.so_far, suspects=tuple(ordered))
            beside = self.so_far.present.hypothesis.names
            self.say(f"leading suspect{' beside ' + ', '.join(beside) if beside else ''}: {ordered[0].effect.name}")

    def reached(self, present: Candidate, first: Candidate | None = None) -> None:
        """Effects have joined.

        Args:
            present: The hypothesis with them.
            first: That without effects, where both are under another law of contact than before.
        """
        if self.so_far is not None and present is not self.so_far.present:
            self.so_far = replace(self.so_far, first=first or self.so_far.first, present=present, suspects=())
            if present.hypothesis.effects:
                self.say(f"found so far: {', '.join(_with_values(present))}")

    def say(self, line: str) -> None:
        """Tell a line of news, but for one that was told last.

        Args:
            line: What has become known.
        """
        if self._news is not None and line != self._said:
            self._said = line
            self._news(line)


def _with_values(present: Candidate) -> list[str]:
    """The effects of a hypothesis, each with its parameters' values."""
    hypothesis = present.hypothesis
    return [
        f"{effect.name} ({', '.join(f'{p.name} {x:.3g}' for p, x in zip(effect.parameters, values, strict=True))})"
        for effect, values in hypothesis.items()
    ]
