"""The verb: from a dataset and a simulator to where they differ, which effect causes it, and a patch."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from tossid.diagnosis.conclude import Engine, explain, known_so_far, report_gap
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.learned import learned_forces
from tossid.diagnosis.next_toss import next_toss
from tossid.diagnosis.over_order import Undone, corrections
from tossid.diagnosis.patch.make import make_patch
from tossid.diagnosis.patch.rerun import rerun, runs_in_mujoco
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.release import bound_frames
from tossid.diagnosis.remarks import remarks_on
from tossid.diagnosis.result import Diagnosis, Interruption
from tossid.diagnosis.simulators import Simulator, check_same_object, checked, moves, read_simulator
from tossid.diagnosis.under_way import UnderWay
from tossid.errors import ConfigError, InputError, TossidError
from tossid.motion.sessions.copies import find_copies
from tossid.motion.sessions.levelling import recordings_apart
from tossid.objects import ObjectModel
from tossid.physics.effects import Effect, effects_for
from tossid.settings.changed import changed
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import Dataset
from tossid.types import Progress, Toss, silent

_log = logging.getLogger(__name__)

MOST = 80
"""Tosses that take part where nobody says how many."""
FEWEST_SHOWN, MOST_SHOWN = 3, 8
"""Tosses whose gap is reported first."""
FEWEST = 3
"""Tosses below which a gap has no interval."""
SHORTEST = 11
"""Frames of a toss that can be predicted: half a window, and the first."""


def diagnose(
    dataset: Dataset,
    simulator: Any = "nominal",
    *,
    settings: DiagnoseSettings = DiagnoseSettings(),
    progress: Progress | None = None,
    **keys: Any,
) -> Diagnosis:
    """Where a simulator differs from a dataset's tosses, which effects explain it, and how far they close the gap.

    Args:
        dataset: Tosses of one object.
        simulator: "nominal" (the object as it is stated), a trained model, the path of an MJCF file, a `World`, a
            function f(q0, v0, n_steps, dt) -> (q, v) over a batch of first states, a `Simulator`, or anything that
            `tossid.diagnosis.simulators.reader` has been taught. A function runs in a process of its own: q0 (B, nq)
            position [m], quaternion wxyz, joints [rad]; v0 (B, nv) linear in the world, angular in the body frame,
            joint rates; q (B, n_steps + 1, nq) and v likewise, first states included.
        settings: Which tosses, and how.
        progress: Called with what is under way, and the share that is done.
        **keys: Settings by name, such as `split="train"` or `without=("magnus",)`.

    Returns:
        The diagnosis; it shows itself, and `save(folder)` writes its report.

    Raises:
        InputError: Too few tosses can be used, or the simulator is of another object, or diverges.
        ConfigError: A key is no setting, or `without` names no effect.
    """
    return prepare(dataset, simulator, settings=changed(settings, keys)).run(UnderWay(progress or silent))


@dataclass(frozen=True)
class Task:
    """A diagnosis that has been checked, and not yet run.

    Attributes:
        problem: Of all tosses that may take part.
        simulator: What is diagnosed.
        about: What the report says of the tosses: the `Diagnosis`'s fields `tosses_of`, `data`, `remarks`, `order`.
    """

    problem: Problem
    simulator: Simulator
    about: dict[str, Any]

    def gap_of_first(self, under_way: UnderWay) -> None:
        """Report the gap of the first few tosses, seconds before `run` reports that of all it searches.

        Args:
            under_way: Given the gap.
        """
        tosses = self.problem.tosses
        few = tosses[: min(len(tosses) // 3, MOST_SHOWN)]
        if len(few) >= FEWEST_SHOWN:
            with suppress(InputError):  # these may be too short; of all, the whole search says it
                report_gap(replace(self.problem, tosses=few, under_way=under_way), of_all=len(tosses))

    def run(self, under_way: UnderWay | None = None) -> Diagnosis:
        """The diagnosis.

        Args:
            under_way: Given what is known as soon as it is.
        """
        under_way = under_way or UnderWay()
        tosses, remarks = searched(self.problem.tosses, self.problem.settings)
        found, undone = explain(replace(self.problem, tosses=tosses, under_way=under_way), self.engine())
        under_way.answer = found
        under_way("next toss and patch", 0.95)
        own = undone.problem
        rng = np.random.default_rng(own.seed)
        following = next_toss(found.hypothesis, found.alternatives, own.tosses, own.sample, rng=rng)
        patch = _patch(found, self.simulator.mjcf, undone)
        under_way("done", 1.0)
        frames = self.simulator.frames
        return replace(
            found,
            passes=None if frames is None else frames / float(own.sample.windows.steps.sum()),
            simulator=self.simulator,
            next_toss=following,
            patch=patch,
            learned=learned_forces(self.simulator.world, self.problem.tosses, self.problem.library),
            **{**self.about, "remarks": (*remarks, *self.about["remarks"], *remarks_on(found, self.simulator))},
        )

    def engine(self) -> Engine:
        """Where whole tosses are predicted: the user's own simulator wherever it can be run."""
        if self.simulator.mjcf is not None:
            return Engine("mujoco", runs_in_mujoco(self.simulator.mjcf))
        return Engine("python" if self.simulator.kind == "python" else "tossid")

    def known_so_far(self, under_way: UnderWay) -> Diagnosis:
        """What a run that was interrupted knew.

        Args:
            under_way: What `run` was given. It must know the gap.
        """
        known = under_way.answer or known_so_far(under_way)
        stopped = known.interruption or Interruption(under_way.stage)
        return replace(known, interruption=stopped, simulator=self.simulator, **self.about)


def searched(tosses: Sequence[Toss], settings: DiagnoseSettings) -> tuple[tuple[Toss, ...], tuple[str, ...]]:
    """The tosses that take part, drawn at random where there are many, and a remark that says so.

    More tosses than `MOST` would narrow the intervals, and cost time and memory in proportion.

    Args:
        tosses: All that may take part.
        settings: Of the diagnosis. Where they name a number of tosses, all take part.
    """
    n = len(tosses)
    if settings.tosses is not None or n <= MOST:
        return tuple(tosses), ()
    drawn = np.sort(np.random.default_rng(settings.seed).permutation(n)[:MOST])
    said = f"{MOST} of {n} tosses take part, drawn at random. tosses={n} takes all, and longer in proportion."
    return tuple(tosses[i] for i in drawn.tolist()), (said,)


def prepare(
    dataset: Dataset,
    simulator: Any = "nominal",
    *,
    settings: DiagnoseSettings = DiagnoseSettings(),
    name: str | None = None,
    data: dict[str, Any] | None = None,
) -> Task:
    """The tosses, the simulator and the library of a diagnosis, checked; `diagnose` runs what this returns.

    Args:
        dataset: Tosses of one object.
        simulator: As of `diagnose`.
        settings: Which tosses, and how.
        name: What the dataset is called in errors and in the report.
        data: gap.json's "data".

    Raises:
        InputError: Too few tosses can be used, or the simulator is of another object, or diverges.
        ConfigError: `without` names no effect.
    """
    judged = read_simulator(simulator, dataset.object)
    recorded = dataset.object if dataset.object.is_stated else judged.world.object
    library = _library(recorded, settings.without)
    tosses_of = _in_words(name or f"dataset of '{recorded.name}'", settings)
    chosen = tuple(dataset.tosses) if settings.split is None else dataset.of_split(settings.split)
    last = None if settings.tosses is None else settings.skip + settings.tosses
    tosses, remarks = _usable(chosen[settings.skip : last], tosses_of)
    moving = () if settings.split in (None, "test") else _moving(dataset.of_split("test"))[1]
    unseen = tuple(toss for toss in moving if toss.name not in _copies((*tosses, *moving)))
    if len(unseen) < len(moving):
        remarks += (f"{len(moving) - len(unseen)} of {len(moving)} unseen tosses left out: they are copies of others.",)
    held = bound_frames(tosses, recorded)
    if held:
        tosses, unseen = (tuple(toss.frames(slice(held, None)) for toss in each) for each in (tosses, unseen))
        frames = "frame is" if held == 1 else f"{held} frames are"
        remarks += (f"The first {frames} left out of each toss: there the object was not in free flight yet.",)
    check_same_object(judged.world, recorded, where=name or "the dataset")
    if judged.reads:
        _log.info(f"{judged.mjcf}: {judged.reads}")
    apart = None if dataset.order is None else recordings_apart(dataset.order)
    if apart is not None:
        remarks += (f"{apart} No change of a simulator closes that part of the gap; 'tossid ingest' levels sessions.",)
    judged, said = checked(judged, tosses, settings)
    remarks += tuple(said)
    # (the dataset's own order is that of its recording where none was looked for)
    names = tuple(toss.name for toss in dataset.tosses)
    if dataset.order is not None and set(names) <= set(dataset.order.names):
        names = dataset.order.names
    problem = Problem(
        tosses,
        Hypothesis(judged.world, judged.law),
        laws=judged.laws,
        library=library,
        n_threads=settings.n_threads,
        seed=settings.seed,
        unseen=unseen,
        names=names,
        sessions=() if dataset.order is None else tuple(each.first for each in dataset.order.sessions[1:]),
        settings=settings,
    )
    about = {"tosses_of": tosses_of, "data": data or {"object": recorded.name}}
    return Task(problem, judged, {**about, "remarks": remarks, "order": dataset.order})


def _library(recorded: ObjectModel, without: Sequence[str]) -> tuple[Effect, ...]:
    """The effects of an object's library but for some."""
    library = effects_for(recorded)
    names = [effect.name for effect in library]
    for name in without:
        if name not in names:
            near = get_close_matches(name, names, n=1)
            raise ConfigError("without", f"there is no effect '{name}'.", suggestion=next(iter(near), None))
    return tuple(effect for effect in library if effect.name not in without)


def _in_words(name: str, settings: DiagnoseSettings) -> str:
    """The tosses in words: the dataset, and which of it."""
    which = [] if settings.split is None else [f"{settings.split} split"]
    if settings.skip or settings.tosses:
        which.append(f"from number {settings.skip + 1}")
    return f"{name}, {', '.join(which)}" if which else name


def _moving(tosses: Sequence[Toss]) -> tuple[tuple[Toss, ...], tuple[Toss, ...]]:
    """Tosses that are half a window long, and those of them in which anything moves."""
    long = tuple(toss for toss in tosses if len(toss) >= SHORTEST)
    return long, tuple(toss for toss in long if moves(toss))


def _copies(tosses: Sequence[Toss]) -> frozenset[str]:
    """Names of the tosses that are copies of earlier ones."""
    return frozenset(copy.name for copy in find_copies(tosses))


def _usable(tosses: Sequence[Toss], tosses_of: str) -> tuple[tuple[Toss, ...], tuple[str, ...]]:
    """The tosses that are no copies, can be predicted, and in which anything moves, and a remark on the others.

    A copy is no toss of its own: folds, tests and intervals are over tosses.

    Raises:
        InputError: They are too few.
    """
    n, (long, moving) = len(tosses), _moving(tosses)
    copies = _copies(moving)
    kept = tuple(toss for toss in moving if toss.name not in copies)
    out = {
        f"{n - len(long)} of {n} are shorter than {SHORTEST} frames": n - len(long),
        f"in {len(long) - len(moving)} of {n} nothing moves": len(long) - len(moving),
        f"{len(copies)} of {n} are copies of others": len(copies),
    }
    why = ", ".join(words for words, count in out.items() if count)
    if len(kept) < FEWEST:
        which = f" that serve ({why})" if why else ""
        raise InputError(
            f"{tosses_of}: has {len(kept)} tosses{which}; a diagnosis needs at least {FEWEST}, for a gap with an "
            "interval"
        )
    return kept, (f"Tosses left out: {why}.",) if why else ()


def _patch(found: Diagnosis, mjcf: Path | None, undone: Undone) -> dict[str, Any]:
    """gap.json's "patch", with its rerun in MuJoCo where there is anything to rerun."""
    problem, h = undone.problem, found.hypothesis
    patch = make_patch(h, mjcf=mjcf)
    report: dict[str, Any] = {**patch.as_json(), "rerun": None}
    report["recording"] = {**report["recording"], **corrections(undone)}
    if patch.changes or patch.recording or mjcf is not None:
        try:
            report["rerun"] = rerun(h, problem.stated, problem.tosses, problem.sample, mjcf=mjcf)
        except TossidError as error:
            report["rerun"] = {"problem": str(error)}
    return report
