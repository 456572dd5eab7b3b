"""Which effects explain the gap between a simulator and tosses: the search, and all that is concluded from it."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.effect_findings import closed_by_each, effect_findings
from tossid.diagnosis.findings import Gap, Interval, Share
from tossid.diagnosis.likelihood.engine_discrepancy import Engine
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.corners import locate
from tossid.diagnosis.localisation.gap import measure_gap, noise_floor, share_left
from tossid.diagnosis.localisation.rollouts import rollout_errors
from tossid.diagnosis.localisation.witnesses import witnesses
from tossid.diagnosis.result import Contact, Diagnosis, Verdict
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.flight_search import power_law_of
from tossid.diagnosis.selection.refinement import (
    intervals,
    line_searched,
    pruned_by_wald_test,
    refitted_on_shifted_windows,
)
from tossid.diagnosis.selection.search import search
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.physics.effects import LIBRARY, OTHER_POWER, Effect, World
from tossid.settings.diagnosis import DiagnoseSettings, VerdictSettings
from tossid.types import Toss

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]


def explain(
    tosses: Sequence[Toss],
    world: World,
    *,
    library: Sequence[Effect] = LIBRARY,
    engine: Engine | None = None,
    n_threads: int = 1,
    seed: int = 0,
    unseen: Sequence[Toss] = (),
    progress: Progress | None = None,
    settings: DiagnoseSettings = DiagnoseSettings(),
) -> Diagnosis:
    """Where the world's predictions differ from the tosses, which effects of the library explain it, and how far.

    Args:
        tosses: Recorded motions of one object; the covariances of their poses are the noise.
        world: The simulator.
        library: The effects to choose from.
        engine: The other engine, whose differences are no evidence; near-rigid MuJoCo if None.
        n_threads: Of simulators.
        seed: Of the folds and of the simulated noise floor.
        unseen: Other tosses, of which only rollouts are shown.
        progress: Called with what is under way, and the share that is done.
        settings: Of everything else. Its `seed` and `threads` are not read here.
    """
    started = time.perf_counter()
    report = progress or _silent
    validator = CrossValidator.of(
        tosses, world.object, seed=seed, n_threads=n_threads, engine=engine, settings=settings
    )
    report("the gap", 0.02)
    validator, world = validator.with_contact_law(world)
    found = search(validator, library, Hypothesis(world), report)
    report("line search", 0.9)
    found = line_searched(validator, found)
    report("shifted windows", 0.92)
    found, spread = refitted_on_shifted_windows(tosses, world.object, validator, found)
    found, spread = pruned_by_wald_test(validator, found, spread)
    report("what is left", 0.97)
    return _concluded(tosses, unseen, library, validator, found, spread, started, seed)


def _silent(text: str, share: float) -> None:
    pass


def _concluded(
    tosses: Sequence[Toss],
    unseen: Sequence[Toss],
    library: Sequence[Effect],
    validator: CrossValidator,
    found: SearchResult,
    spread: Array | None,
    started: float,
    seed: int,
) -> Diagnosis:
    """Everything that is said of what the search found."""
    n, first, present, settings = validator.n, found.first, found.present, validator.settings
    begin = make_windows(unseen, first.hypothesis.base.object, settings=settings.likelihood) if unseen else None
    floor = noise_floor(present, validator, seed=seed)
    gap = measure_gap(tosses, first, validator, floor)
    left = measure_gap(tosses, present, validator, floor) if present.hypothesis.effects else gap
    inside = [name for name in present.hypothesis.names if name not in found.unnamed]
    named = tuple(sorted(inside, key=lambda name: -found.needed[name].total))
    closed, unexplained = share_left(first, present, validator, floor)
    closes = closed_by_each(validator, found, floor)
    if found.unnamed:
        unnamed = [closes[name] for name in found.unnamed]
        closed, unexplained = _without_unnamed(closed, unexplained, unnamed)
    return Diagnosis(
        verdict=gap_verdict(
            gap, left, closed, found.unnamed, unexplained, any_named=bool(named), settings=settings.verdict
        ),
        gap=gap,
        left=left,
        findings=effect_findings(library, validator, found, named, floor, spread, closes),
        named=named,
        gap_closed=closed,
        unexplained=unexplained,
        steps=tuple(rollout_errors(tosses, unseen, each, validator, begin) for each in found.history),
        hypothesis=present.hypothesis,
        n_tosses=n,
        seconds=time.perf_counter() - started,
        alternatives=found.alternatives,
        contact=_contact(validator, found),
        other_laws=tuple(
            (name, intervals(each.fitted, n)[power_law_of(each, name).name][OTHER_POWER])
            for name, each in found.other_laws.items()
        ),
        unsteady=found.unsteady,
        place=locate(tosses, first, present, gap, left, seed=seed, settings=settings),
        witnesses=witnesses(unseen or tosses, first.hypothesis.world(), present.hypothesis.world(), settings.witnesses),
    )


def _without_unnamed(
    closed: Interval, unexplained: tuple[Share, ...], unnamed: Sequence[Interval]
) -> tuple[Interval, tuple[Share, ...]]:
    """What named effects close, and phases with some left, given the shares that effects without a name close."""
    value, low, high = (max(0.0, sum(part)) for part in zip(*((s.value, s.low, s.high) for s in unnamed), strict=True))
    closed = Interval(closed.value - value, closed.low - value, closed.high - value)
    if value > 0:
        others = (share for share in unexplained if share.name != "flight")
        unexplained = (Share("flight", Interval(value, low, high)), *others)
    return closed, unexplained


def gap_verdict(
    gap: Gap,
    left: Gap,
    closed: Interval,
    unnamed: Collection[str],
    unexplained: Sequence[Share],
    *,
    any_named: bool,
    settings: VerdictSettings = VerdictSettings(),
) -> Verdict:
    """What the named effects make of a gap.

    To be near the floor is not enough where the gap was small: more than half of it has to be closed too.

    Args:
        gap: Without effects.
        left: With effects.
        closed: Share of the gap that the named effects close.
        unnamed: Effects that stand in for something without a name.
        unexplained: Phases in which clearly something is left.
        any_named: Whether there are named effects.
        settings: The limits.
    """
    if not any_named:
        nothing = gap.total.value < settings.no_gap * gap.noise_floor or gap.total.low < gap.noise_floor
        return "no_gap" if nothing and not unnamed else "unexplained"
    if closed.value <= settings.partly_closed:
        return "unexplained"
    reached = left.total.value < settings.floor_reached * left.noise_floor
    if not unnamed and (reached or (closed.value > settings.all_closed and not unexplained)):
        return "explained"
    return "partly_explained"


def _contact(validator: CrossValidator, found: SearchResult) -> Contact:
    """The contact law that the tosses follow most."""
    if validator.engine.model is not None:
        return "own"
    return "relaxed" if found.first.hypothesis.base.law.lifting > 0 else "coulomb"
