"""How well changes over the order of recording are found, without the search for effects that are in all tosses.

    python -m pipelines.tools.experiments.changes_over_order [cases=40] [seed=0] [first=0] [tosses=40] [only=FORM]

The cases are those of `tossid audit over_order=true`, through TUM files as there. Each is looked at as a diagnosis
does before its search: what changes, from which toss on, and by how much. That costs a tenth of a diagnosis. A line of
JSON a case goes to standard output, and the measures to standard error.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from pipelines.cli.console import Console
from tossid.diagnosis.audit.cases import Case, draw_over_order
from tossid.diagnosis.audit.making import TOSSES, make_case
from tossid.diagnosis.audit.over_order import score_over_order
from tossid.diagnosis.audit.scores import summarise
from tossid.diagnosis.audit.spoilt import read_case_tosses
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.sessions.explained import over_order
from tossid.diagnosis.sessions.looking import Corrections, TossOrder, undo_changes
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import effects_for
from tossid.settings.diagnosis.audit import AuditSettings
from tossid.settings.diagnosis.diagnose import DiagnoseSettings


def looked_at(case: Case, model: ObjectModel, settings: AuditSettings) -> dict[str, Any]:
    """Make a case, look for changes over its order, and score what was found."""
    how = DiagnoseSettings()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        truth = make_case(case, model, settings, folder)
        tosses, world = read_case_tosses(folder / TOSSES)
    order = TossOrder.of(tosses, (), [toss.name for toss in tosses], ())
    make = partial(CrossValidator.of, seed=case.seed % 1000, n_threads=1, engine=None, settings=how)
    _, last, corrections = undo_changes(Corrections(tosses), world, effects_for(model), order, make, how)
    changing = [each for each, _ in corrections.undone] + ([] if last.effect is None else [last.effect])
    found = [{"name": each.effect.name, **over_order(each, tosses).as_json()} for each in changing]
    left = [{"before": tosses[change.at].name} for change in last.changes]
    gap = {"effects": found, "changes_left": left}
    return {
        "case": case.index,
        "engine": case.engine,
        "effects": truth["effects"],
        "order": truth["case"]["order"],
        "displacement": truth["displacement"],
        "found": found,
        **score_over_order(truth, gap, settings=settings.scoring),
    }


def main(arguments: list[str]) -> None:
    """Look at cases and say how many changes were found."""
    given = dict(argument.split("=", 1) for argument in arguments)
    count, first = int(given.get("cases", "40")), int(given.get("first", "0"))
    settings = replace(AuditSettings(), tosses=int(given.get("tosses", "40")), seed=int(given.get("seed", "0")))
    cases = draw_over_order(
        first + count,
        seed=settings.seed,
        engines=settings.engines,
        displacement=settings.displacement,
        tosses=settings.tosses,
    )[first:]
    model, console, scores = load_object("cube"), Console(), []
    for case in cases:
        assert case.order is not None
        if given.get("only", case.order.form) == case.order.form:
            scores.append(looked_at(case, model, settings))
            sys.stdout.write(json.dumps(scores[-1], default=float) + "\n")
            sys.stdout.flush()
    named = [{**score, "kind": "order", "parameters": [], "closed": None, "phase_right": None} for score in scores]
    measures = {name: value for name, value in summarise(named).items() if "change" in name or "drift" in name}
    rows = [[name, str(found.get("count", found.get("value"))), str(found["of"])] for name, found in measures.items()]
    console.table(("measure", "found", "of"), rows)


if __name__ == "__main__":
    main(sys.argv[1:])
