"""How many tosses take part where there are many: as many as the answer needs, and the others judge it.

Some tosses are drawn and searched. The effects that are found are then fitted once more, to as many other tosses. Where
both fits agree within their intervals, and the share of the gap that is closed on the others leads to the same verdict,
the answer stands still: more tosses would make the intervals narrower, and the search slower. If not, twice as many are
searched. Time and memory hang on how many tosses are searched, and not on how many there are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.engine_discrepancy import Engine
from tossid.diagnosis.likelihood.fitting import fit
from tossid.diagnosis.result import Diagnosis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.refinement import intervals
from tossid.diagnosis.sessions.explained import Explained
from tossid.diagnosis.under_way import UnderWay
from tossid.settings.diagnosis.diagnose import DiagnoseSettings, VerdictSettings
from tossid.types import Toss

Search = Callable[[Sequence[Toss], Sequence[Toss]], Explained]
"""The diagnosis of some tosses, judged by others."""


def searched(
    tosses: Sequence[Toss],
    search: Search,
    *,
    engine: Engine | None,
    n_threads: int,
    settings: DiagnoseSettings,
    under_way: UnderWay,
) -> tuple[Explained, tuple[str, ...]]:
    """The diagnosis of as many tosses as the answer needs.

    Args:
        tosses: All that may take part.
        search: Diagnoses some tosses, and judges the answer by others.
        engine: The other engine; near-rigid MuJoCo if None.
        n_threads: Of simulators.
        settings: Of the diagnosis. Where they name a number of tosses, all take part.
        under_way: Told why more tosses are searched, and what is known before the search has been repeated.

    Returns:
        The diagnosis with the tosses that took part, and a remark that says how many they are and why.
    """
    how, n = settings.enough, len(tosses)
    count, said = how.first, ""
    while settings.tosses is None and 2 * count <= n:
        part = _drawn(tosses, slice(count), settings)
        others = _drawn(tosses, slice(count, count + max(count, how.judges)), settings)
        explained = search(part, others)
        judges = explained.unseen
        if others_disagree := disagreement(
            explained.diagnosis, judges[-count:], engine=engine, n_threads=n_threads, settings=settings
        ):
            why = f"With {count}, {others_disagree}."
            said, count = f"{said} {why}", 2 * count
            under_way.say(f"{why} {count if 2 * count <= n else f'All {n}'} tosses are searched now")
            continue
        # only the last answer needs to be repeated
        return explained.repeated(under_way), (_in_words(explained.diagnosis, n, count, len(judges)) + said,)
    return search(tosses, ()).repeated(under_way), (f"All {n} tosses take part.{said}",) if said else ()


def first_drawn(tosses: Sequence[Toss], settings: DiagnoseSettings) -> tuple[Toss, ...]:
    """The tosses that are searched first.

    Args:
        tosses: All that may take part.
        settings: Of the diagnosis. Where they name a number of tosses, all take part.
    """
    count = settings.enough.first
    few = settings.tosses is not None or 2 * count > len(tosses)
    return tuple(tosses) if few else _drawn(tosses, slice(count), settings)


def _drawn(tosses: Sequence[Toss], which: slice, settings: DiagnoseSettings) -> tuple[Toss, ...]:
    """Some of the tosses in the order in which they are drawn, as they stand in the dataset."""
    order = np.random.default_rng(settings.seed).permutation(len(tosses))
    return tuple(tosses[i] for i in sorted(order[which].tolist()))


def disagreement(
    found: Diagnosis, others: Sequence[Toss], *, engine: Engine | None, n_threads: int, settings: DiagnoseSettings
) -> str:
    """What other tosses contradict of a diagnosis, in words; empty if nothing.

    Args:
        found: The diagnosis, judged by them.
        others: Tosses that took no part.
        engine: The other engine; near-rigid MuJoCo if None.
        n_threads: Of simulators.
        settings: Of the diagnosis.
    """
    judged, tolerance = found.unseen, settings.enough.tolerance
    if judged is not None and _another_verdict(found.gap_closed, judged.closed, settings.verdict):
        shares = f"{found.gap_closed.value:.2f}, and {judged.closed.value:.2f} on others"
        return f"the share of the gap that is closed was {shares}, where the verdict is another"
    if not found.hypothesis.effects:
        return ""
    engine = engine if found.contact == "own" else None
    validator = CrossValidator.of(
        others, found.hypothesis.base.object, seed=settings.seed, n_threads=n_threads, engine=engine, settings=settings
    )
    begin = validator.evaluate(found.hypothesis)
    again = intervals(fit(begin.evidence, found.hypothesis, n_tosses=validator.n), validator.n)
    for finding in found.findings:
        for name, interval in finding.parameters.items():
            other = again.get(finding.name, {}).get(name)
            if other is not None and not _agree(interval, other, tolerance):
                return f"{name} of {finding.name} was {interval.value:.4g}, and {other.value:.4g} on others"
    return ""


def _another_verdict(closed: Interval, on_others: Interval, limits: VerdictSettings) -> bool:
    """Whether the share that other tosses show is surely on the other side of a limit of verdicts."""
    return any(
        on_others.high <= limit if closed.value > limit else on_others.low > limit
        for limit in (limits.partly_closed, limits.all_closed)
    )


def _agree(one: Interval, other: Interval, tolerance: float) -> bool:
    """Whether two values differ by no more than their intervals, whose halves add as errors do."""
    above, below = (one, other) if one.value > other.value else (other, one)
    apart = float(np.hypot(above.value - above.low, below.high - below.value))
    return above.value - below.value <= tolerance * apart


def _in_words(found: Diagnosis, n: int, count: int, judges: int) -> str:
    fitted = "values fitted to as many others agree, and so does the verdict by what is closed of their gap"
    if not found.hypothesis.effects:
        fitted = "nothing was found in them, and others show the same gap"
    taken = f"{count} of {n} tosses were searched, drawn at random, and {judges} others judge"
    return f"{taken}: {fitted}. tosses={n} takes all."
