"""How many tosses until a name is certain: each next toss chosen, or at random?

    python -m pipelines.tools.experiments.active out=FILE.jsonl [cases=10] [draws=3] [most=24] [seed=0]

A case has tosses of a cube with one effect of the library, simulated with the real cube's noise, and rivals that
ordinary tosses confuse with it. It begins with four ordinary tosses. The effect and its rivals are then fitted to all
tosses so far, and one toss more is made, until held-out tosses prefer the effect over each rival at the level at which
a diagnosis ends a class. `chosen` makes the toss that `next_toss` proposes between the hypotheses that are left;
`random` draws from the same feasible releases, several times; `ordinary` draws releases as the first ones. A case that
has not ended at `most` tosses says so. Each line of the file is a case and a way; lines that are there are not made
again. The table goes to standard output at the end.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipelines.cli.console import Console
from pipelines.files.json_lines import add_line, lines_so_far
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.next_toss import draw_releases, separations
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.screening import screen
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import World, effect_named
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.settings.synthesis import LcpEngine, NoiseSettings, SynthesizeSettings
from tossid.synthesis.tosses import add_noise, make_tosses, tosses_from
from tossid.types import Toss

Array = NDArray[np.float64]
Way = tuple[str, int]
"""How the next toss is made, and which of the draws."""

FIRST = 4
"""Ordinary tosses with which a case begins."""


@dataclass(frozen=True)
class Rivalry:
    """An effect at its true values, and those that ordinary tosses confuse with it."""

    effect: str
    values: Mapping[str, float]
    rivals: tuple[str, ...]


RIVALRIES = (
    Rivalry("friction", {"mu": 0.19}, ("cohesion", "adhesion")),
    Rivalry("cohesion", {"c_n": 0.05}, ("friction", "adhesion", "velocity_friction")),
    Rivalry("anisotropic_friction", {"x_mu": 0.17, "y_mu": 0.19}, ("friction", "velocity_friction")),
    Rivalry("velocity_friction", {"static_mu": 0.195, "sliding_mu": 0.165, "speed_ms": 0.3}, ("friction", "cohesion")),
    Rivalry("linear_drag", {"c_nspm": 0.003}, ("quadratic_drag", "magnus")),
    Rivalry("quadratic_drag", {"c_ns2pm2": 0.002}, ("linear_drag", "magnus")),
    Rivalry("magnus", {"c_ns2pm": 0.0006}, ("vortex", "uniform_force")),
    Rivalry("restitution", {"e": 0.05}, ("compliance", "rounded_corners")),
    Rivalry("ground_tilt", {"x_rad": 0.0015, "y_rad": 0.0}, ("uniform_force", "world_tilt")),
    Rivalry("gravity", {"g_ms2": 9.77}, ("time_base",)),
)
"""What the cases are. No rival contains the effect, for it could then not predict worse.
Rigid contact has no time scale of its own, so that no toss can split the last."""


def simulated(q0: Array, v0: Array, case: Rivalry, model: ObjectModel, rng: np.random.Generator) -> tuple[Toss, ...]:
    """Tosses from given releases under the true effect, as they are recorded."""
    settings = _synthesis(case)
    tosses, _ = tosses_from(q0, v0, settings, model)
    return add_noise(tosses, model, settings.noise, rng)


def _synthesis(case: Rivalry) -> SynthesizeSettings:
    return SynthesizeSettings(
        engine=LcpEngine(substeps=64),
        effects={case.effect: dict(case.values)},
        noise=NoiseSettings(position=1.5e-4, rotation=1.5e-3),
        tosses=FIRST,
    )


def ordinary(count: int, case: Rivalry, model: ObjectModel, rng: np.random.Generator) -> tuple[Toss, ...]:
    """Tosses as `synthesize` releases them."""
    settings = replace(_synthesis(case), tosses=count)
    tosses, _ = make_tosses(settings, model, rng)
    return add_noise(tosses, model, settings.noise, rng)


def candidates(
    tosses: Sequence[Toss], names: Sequence[str], model: ObjectModel
) -> tuple[CrossValidator, list[Candidate]]:
    """Each effect alone, fitted to the tosses, and what it predicts of those that were held out."""
    validator = CrossValidator.of(tosses, model, seed=0)
    first = validator.evaluate(Hypothesis(World(model)))
    out = []
    for name in names:
        effect = effect_named(name)
        begin = screen(validator, first, effect)
        out.append(validator.cross_validate(first, effect, begin.start, near=begin.evidence(first)))
    return validator, out


def left_of(validator: CrossValidator, fitted: Sequence[Candidate]) -> list[int]:
    """Numbers of the rivals that held-out tosses do not tell from the first; of all, if the first is not ahead."""
    level = validator.settings.selection.class_level
    return [i for i, rival in enumerate(fitted[1:], 1) if validator.p_value_over(fitted[0], rival) > level]


def run_case(case: Rivalry, number: int, way: Way, *, most: int, seed: int) -> dict[str, Any]:
    """Toss until the name is certain.

    Args:
        case: What is true, and its rivals.
        number: Of the case.
        way: How the next toss is made.
        most: Tosses at which to give up.
        seed: Of all that is drawn.

    Returns:
        A line of the file: `tosses` until the name was certain (None: it was not); with each number of tosses, how many
        rivals were `left`, and the effect's `lead` in log-likelihood of held-out tosses over the nearest rival; and for
        each chosen toss the separation that was expected.
    """
    model, settings = load_object("cube"), DiagnoseSettings()
    started = time.process_time()
    rng = np.random.default_rng([seed, number])
    tosses = list(ordinary(FIRST, case, model, rng))
    rng = np.random.default_rng([seed, number, 1 + way[1], len(way[0])])
    names = (case.effect, *case.rivals)
    history, leads, expected = [], [], []
    while True:
        validator, fitted = candidates(tosses, names, model)
        left = left_of(validator, fitted)
        history.append(len(left))
        leads.append(min(float(validator.gain_over(fitted[0], rival).sum()) for rival in fitted[1:]))
        if not left or len(tosses) >= most:
            break
        if way[0] == "ordinary":
            tosses += ordinary(1, case, model, rng)
            continue
        among = settings.next_toss.candidates if way[0] == "chosen" else 1
        releases = draw_releases(tosses, model, among, rng=rng, settings=settings.next_toss)
        best = 0
        if way[0] == "chosen":
            frames = int(np.median([len(toss) for toss in tosses])) - 1
            rivals = [fitted[0].hypothesis, *(fitted[i].hypothesis for i in left)]
            size = separations(rivals, releases, tosses, frames)
            best = int(np.argmax(size))
            expected.append(float(size[best]))
        tosses += simulated(releases.q[best : best + 1], releases.v[best : best + 1], case, model, rng)
    return {
        "case": number,
        **asdict(case),
        "way": way[0],
        "draw": way[1],
        "tosses": len(tosses) if not history[-1] else None,
        "most": most,
        "left": history,
        "lead": leads,
        "expected_sd": expected,
        "cpu_s": time.process_time() - started,
    }


def table(lines: Sequence[Mapping[str, Any]]) -> str:
    """The cases as a Markdown table: tosses until the name was certain, in each way, and the lead for each of these."""
    out = ["| effect | rivals | chosen | random | ordinary |", "|---|---|---|---|---|"]
    for number in sorted({line["case"] for line in lines}):
        of_case = [line for line in lines if line["case"] == number]
        cells = []
        for way in ("chosen", "random", "ordinary"):
            made = [line for line in of_case if line["way"] == way]
            cells.append(", ".join(_in_words(line) for line in made))
        rivals = ", ".join(of_case[0]["rivals"])
        out.append(f"| {of_case[0]['effect']} | {rivals} | " + " | ".join(cells) + " |")
    return "\n".join(out)


def _in_words(line: Mapping[str, Any]) -> str:
    """Tosses until the name was certain, and in brackets the lead that each toss after the first ones brought."""
    tosses = FIRST - 1 + len(line["left"])
    gained = (line["lead"][-1] - line["lead"][0]) / max(1, tosses - FIRST)
    return f"{tosses} ({gained:.1f})" if line["tosses"] else f"over {line['most']} ({gained:.1f})"


def main(arguments: list[str]) -> None:
    """Run the cases that the file does not have, and print the table."""
    given = dict(argument.split("=", 1) for argument in arguments)
    out, console = Path(given["out"]), Console()
    n, draws, most, seed = (int(given.get(k, d)) for k, d in (("cases", 10), ("draws", 3), ("most", 24), ("seed", 0)))
    lines = lines_so_far(out)
    done = {(line["case"], line["way"], line["draw"]) for line in lines}
    ways: list[Way] = [("chosen", 0), *(("random", k) for k in range(draws)), ("ordinary", 0)]
    for number, case in enumerate(RIVALRIES[:n]):
        for way in ways:
            if (number, *way) in done:
                continue
            lines.append(run_case(case, number, way, most=most, seed=seed))
            add_line(out, lines[-1])
            console.say(f"{case.effect}, {way[0]} {way[1]}: {lines[-1]['tosses']} tosses")
    sys.stdout.write(table(lines) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
