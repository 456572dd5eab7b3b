"""How well changes over the order of recording are found, without the search for effects that are in all tosses.

    python -m pipelines.tools.experiments.changes_over_order [cases=40] [nulls=40] [data=CUBE.h5] [seed=0] [first=0]
        [tosses=40] [only=FORM] [effects=NAME,NAME] [boundary=TOSS]
    python -m pipelines.tools.experiments.changes_over_order recorded=FILE.h5 [split=train] [tosses=40] [seed=0]

The cases are those of `tossid audit over_order=true` in which something changes, through TUM files as there. In nulls,
nothing changes: in turns, there is no effect, or all tosses have one; of a dataset, real tosses are drawn in random
order, one null in three. Each is looked at as a diagnosis does before its search: what changes, from which toss on, and
by how much. `first` leaves out the changes before, and `effects` those of other effects. With `boundary`, the dataset
is said to have a session that begins with this toss, whether or not anything changes there. A line of JSON a case goes
to standard output, and the measures to standard error. The second form looks at tosses of a dataset in their own order,
drawn as `diagnose` draws them where no number of tosses is given.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.cli.console import Console
from tossid.diagnosis.audit.cases import Case, draw_nulls, draw_over_order
from tossid.diagnosis.audit.making import TOSSES, make_case
from tossid.diagnosis.audit.over_order import NULLS, SHUFFLED, score_over_order
from tossid.diagnosis.audit.run import only_in_lcp
from tossid.diagnosis.audit.scores import summarise
from tossid.diagnosis.audit.spoilt import read_case_tosses
from tossid.diagnosis.audit.steps import withheld
from tossid.diagnosis.audit.strengths import strengths_for
from tossid.diagnosis.problem import Problem, session_starts
from tossid.diagnosis.sessions.explained import over_order
from tossid.diagnosis.sessions.heights import have_own_heights
from tossid.diagnosis.sessions.looking import undo_changes
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import World, effects_for
from tossid.settings.diagnosis.audit import AuditSettings
from tossid.store import read_dataset


def made(case: Case, model: ObjectModel, settings: AuditSettings) -> tuple[Problem, dict[str, Any]]:
    """The problem of a simulated case, and its truth."""
    with tempfile.TemporaryDirectory() as name:
        truth = make_case(case, model, settings, Path(name))
        return withheld(Path(name) / TOSSES, (), case.seed % 1000), {**truth, "engine": case.engine}


def drawn(data: Path, count: int, settings: AuditSettings) -> Iterator[tuple[Problem, dict[str, Any]]]:
    """Problems of real tosses in random order, and their truth."""
    tosses, world = read_case_tosses(data)
    for i in range(count):
        chosen = np.random.default_rng([settings.seed, 8, i]).permutation(len(tosses))[: settings.tosses]
        problem = Problem(tuple(tosses[k] for k in chosen), world, effects_for(world.object), seed=i)
        yield problem, {"case": {"index": i, "order": {"form": SHUFFLED, "at": 0}}, "effects": {}, "engine": "real"}


def recorded(data: Path, split: str | None, settings: AuditSettings) -> Problem:
    """The problem of a dataset: some of its tosses in the order of recording, and the stated simulator."""
    dataset = read_dataset(data)
    tosses = dataset.tosses if split is None else dataset.of_split(split)
    chosen = np.random.default_rng(settings.seed).permutation(len(tosses))[: settings.tosses]
    taken = tuple(tosses[i] for i in sorted(chosen.tolist()))
    return Problem(
        taken,
        World(dataset.object),
        effects_for(dataset.object),
        names=tuple(toss.name for toss in dataset.tosses) if dataset.order is None else dataset.order.names,
        sessions=session_starts(dataset.order),
        own_heights=have_own_heights(taken, dataset.object, dataset.order),
    )


def changes_of(problem: Problem) -> dict[str, Any]:
    """Look for changes over the order of tosses: the effects that change, and where anything else does."""
    problem, started = problem.in_order(), time.process_time()
    _, last, corrections = undo_changes(problem)
    changing = [each for each, _ in corrections.undone] + ([] if last.effect is None else [last.effect])
    found = [{"name": each.effect.name, **over_order(each, problem.tosses).as_json()} for each in changing]
    left = [{"before": problem.tosses[change.at].name, "p": dict(change.p)} for change in last.changes]
    return {"found": found, "left": left, "cpu_s": time.process_time() - started}


def looked_at(problem: Problem, truth: Mapping[str, Any], settings: AuditSettings) -> dict[str, Any]:
    """Look for changes over the order of a case, and score what was found."""
    changes = changes_of(problem)
    gap = {"effects": changes["found"], "changes_left": changes["left"]}
    return {
        "case": truth["case"]["index"],
        "engine": truth["engine"],
        "effects": truth["effects"],
        "order": truth["case"]["order"],
        "displacement": truth.get("displacement", {}),
        **changes,
        **score_over_order(truth, gap, settings=settings.scoring),
    }


def problems(given: Mapping[str, str], settings: AuditSettings) -> Iterator[tuple[Problem, dict[str, Any]]]:
    """The problems of all cases, those in which something changes first."""
    model, (changes, nulls) = load_object("cube"), (int(given.get(key, "40")) for key in ("cases", "nulls"))
    shared: dict[str, Any] = {key: getattr(settings, key) for key in ("seed", "engines", "displacement")}
    cases = draw_over_order(2 * changes + 1, tosses=settings.tosses, **shared)
    cases = tuple(case for case in cases if case.order is not None and case.order.form not in NULLS)[
        int(given.get("first", "0")) : changes
    ]
    real = nulls // 3 if "data" in given else 0
    only_lcp = only_in_lcp(model, settings.engines)
    of_all_engines = [name for name in strengths_for(model) if name not in only_lcp]
    cases += draw_nulls(nulls - real, effects=of_all_engines, **shared)
    for case in cases:
        kind = "" if case.order is None else case.order.form, ",".join(case.effects)
        if kind == (given.get("only", kind[0]), given.get("effects", kind[1])):
            yield made(case, model, settings)
    if real and given.get("only", SHUFFLED) == SHUFFLED:
        yield from drawn(Path(given["data"]), real, settings)


def main(arguments: list[str]) -> None:
    """Look at cases and say how many changes were found."""
    given = dict(argument.split("=", 1) for argument in arguments)
    settings = replace(AuditSettings(), tosses=int(given.get("tosses", "40")), seed=int(given.get("seed", "0")))
    if "recorded" in given:
        found = changes_of(recorded(Path(given["recorded"]), given.get("split"), settings))
        sys.stdout.write(json.dumps(found, default=float, indent=1) + "\n")
        return
    scores = []
    for problem, truth in problems(given, settings):
        if "boundary" in given:
            problem = replace(problem, sessions=(problem.tosses[int(given["boundary"])].name,))
        scores.append(looked_at(problem, truth, settings))
        sys.stdout.write(json.dumps(scores[-1], default=float) + "\n")
        sys.stdout.flush()
    console = Console()
    console.table(("what changes", "cases", "when (within 3)", "named", "nothing else named", "form"), by_kind(scores))
    console.table(("measure", "found", "of"), measures(scores))


def measures(scores: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Rows of the audit's measures of changes and drifts: name, how many were found or the value, and of how many."""
    unknown: dict[str, Any] = {
        "kind": "order",
        "parameters": [],
        "joint_ranks": [],
        "closed": None,
        "phase_right": None,
    }
    every = summarise([{**each, **unknown} for each in scores])
    found = {name: of for name, of in every.items() if "change" in name or "drift" in name}
    return [[name, str(of.get("count", of.get("value"))), str(of["of"])] for name, of in found.items()]


def by_kind(scores: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Rows of how many cases of each kind were right."""
    kinds: dict[str, list[Mapping[str, Any]]] = {}
    for score in scores:
        form = score["order"]["form"]
        name = form if form in NULLS else f"{' and '.join(sorted(score['effects']))}: {form}"
        kinds.setdefault(name, []).append(score)

    def count(some: Sequence[Mapping[str, Any]], key: str) -> str:
        known = [score[key] for score in some if score[key] is not None]
        return f"{sum(known)} of {len(known)}" if known else ""

    rows = []
    for name, some in kinds.items():
        moments, named, forms = (count(some, key) for key in ("moment_right", "right", "form_right"))
        alone = f"{sum(not score['further'] for score in some)} of {len(some)}"
        rows.append([name, str(len(some)), moments, named, "" if name in NULLS else alone, forms])
    return rows


if __name__ == "__main__":
    main(sys.argv[1:])
