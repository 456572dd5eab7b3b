"""How much an answer depends on the settings: a diagnosis with each of ten of them halved and doubled.

    python -m pipelines.tools.experiments.sensitivity FILE.h5 out=LINES.jsonl [split=train] [tosses=24]
        [seed=0] [repeats=0] [part=1/1]
    python -m pipelines.tools.experiments.sensitivity table=LINES.jsonl
    python -m pipelines.tools.experiments.sensitivity brief=LINES.jsonl

One JSON line a diagnosis: what was changed, the verdict, names, values with 95 % intervals, and the share of the gap
that is closed. Lines that are in the file already are not computed again. `table` prints them in Markdown, and `brief`
without intervals of values, for diagnoses that find many effects. With `part=1/2` and `part=2/2` two processes share
the diagnoses and the file.

The ten are those that decide what an answer rests on. Four decide what the tosses say: how long windows are, how much
flight counts over contact, how far recorded velocities are trusted, and how much outliers count. One bounds what a
single window can gain. Five decide what becomes of that: how many effects are fitted in full, into how many folds the
tosses are divided, how significant a gain must be, how much of the gap it must close, and which effects are said to be
confusable with what was found.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import tossid
from pipelines.files.json_lines import add_line, lines_so_far, read_lines
from tossid.diagnosis.result import Diagnosis
from tossid.settings.changed import changed
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import Dataset, read_dataset

HALVED_AND_DOUBLED = (
    "likelihood.windows.length",
    "likelihood.windows.flight_weight",
    "likelihood.windows.velocity_std",
    "likelihood.density.degrees_of_freedom",
    "likelihood.density.large_gain",
    "selection.candidates",
    "cross_validation.folds",
    "selection.level",
    "selection.least_closed",
    "selection.class_gain",
)
CURVATURES = {2.0: 0.56, 8.0: 0.73}
"""`likelihood.density.curvature` by degrees of freedom, to which it belongs. It grows as E[l''] / E[w] does, with
Student's log density l and weights w on Gaussian residuals (0.64, 0.75 and 0.84 for 2, 4 and 8)."""


def variants() -> Iterator[dict[str, Any]]:
    """Settings that differ from the defaults: none, then each of the ten halved and doubled."""
    yield {}
    for key in HALVED_AND_DOUBLED:
        value: Any = DiagnoseSettings()
        for name in key.split("."):
            value = getattr(value, name)
        for factor in (0.5, 2.0):
            new = type(value)(factor * value)
            keys = {key: new}
            if key.endswith("degrees_of_freedom"):
                keys["likelihood.density.curvature"] = CURVATURES[new]
            yield keys


def line_of(keys: Mapping[str, Any], found: Diagnosis) -> dict[str, Any]:
    """What a diagnosis says.

    Args:
        keys: The settings that differ from the defaults.
        found: The diagnosis.
    """
    return {
        "settings": dict(keys),
        "verdict": found.verdict,
        "named": list(found.named),
        "minor": list(found.minor),
        "candidates": list(found.candidates),
        "alternatives": {each.name: list(each.confusable_with) for each in found.findings if each.confusable_with},
        "values": {
            f"{each.name}.{name}": [value.value, value.low, value.high]
            for each in found.findings
            if each.name in found.found
            for name, value in each.parameters.items()
        },
        "gap": found.gap.total.as_json(),
        "closed": found.gap_closed.as_json(),
    }


def run(dataset: Dataset, out: Path, part: str = "1/1", **keys: Any) -> None:
    """Diagnoses that are not in the file yet, each added to it as a line.

    Args:
        dataset: The tosses.
        out: The file.
        part: Which of how many parts of the diagnoses, as "1/2".
        **keys: Settings of all diagnoses.
    """
    done = [line["settings"] for line in lines_so_far(out)]
    which, parts = (int(each) for each in part.split("/"))
    for variant in list(variants())[which - 1 :: parts]:
        if variant in done:
            continue
        began = time.process_time()
        found = tossid.diagnose(dataset, settings=changed(DiagnoseSettings(), {**keys, **variant}))
        add_line(out, {**line_of(variant, found), "cpu_s": round(time.process_time() - began, 1)})


def table(lines: list[dict[str, Any]]) -> str:
    """The lines in Markdown, in the order of `variants`.

    Args:
        lines: As `run` writes them.
    """
    rows = [
        "| setting | value | verdict | named, or (candidates) | 95 % | cannot be told from | closed [%] |",
        "|---|---|---|---|---|---|---|",
    ]
    for key, value, line in _in_order(lines):
        values: dict[str, list[str]] = {}
        for name, (middle, low, high) in line["values"].items():
            effect, parameter = name.split(".")
            values.setdefault(effect, []).append(f"{parameter} {middle:.4g} ({low:.4g} to {high:.4g})")
        found = [*line["named"], *line["candidates"]]
        names = ", ".join([*line["named"], *(f"({each})" for each in line["candidates"])]) or "nothing"
        sizes = "; ".join(f"{each}: {', '.join(values[each])}" for each in found)
        others = "; ".join(", ".join(line["alternatives"][each]) for each in found if each in line["alternatives"])
        rows.append(f"| {key} | {value} | {line['verdict']} | {names} | {sizes} | {others} | {closed(line)} |")
    return "\n".join(rows)


def brief(lines: list[dict[str, Any]]) -> str:
    """The lines in Markdown, in the order of `variants`, with values alone; what is named is bold.

    Args:
        lines: As `run` writes them.
    """
    rows = ["| setting | value | verdict | found (**named**) | closed [%] |", "|---|---|---|---|---|"]
    for key, value, line in _in_order(lines):
        sizes: dict[str, list[str]] = {}
        for name, (middle, _, _) in line["values"].items():
            sizes.setdefault(name.partition(".")[0], []).append(f"{middle:.3g}")
        found = [f"**{name}** {', '.join(sizes[name])}" for name in sorted(line["named"])]
        found += [f"{name} {', '.join(sizes[name])}" for name in sorted(line["candidates"])]
        verdict = line["verdict"].replace("_", " ")
        rows.append(f"| {key} | {value} | {verdict} | {'; '.join(found)} | {closed(line)} |")
    return "\n".join(rows)


def _in_order(lines: list[dict[str, Any]]) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Each line with the setting that is changed and its value, in the order of `variants`."""
    order = list(variants())
    for line in sorted(lines, key=lambda line: order.index(line["settings"])):
        yield *next(iter(line["settings"].items()), ("as it is", "")), line


def closed(line: Mapping[str, Any]) -> str:
    """The share that a line says is closed, with its interval [%].

    Args:
        line: With the share and its interval under "closed".
    """
    value, low, high = (f"{100 * each:.0f}" for each in (line["closed"]["value"], *line["closed"]["ci95"]))
    return f"{value} ({low} to {high})"


def main(arguments: list[str]) -> None:
    """Run what is missing, or print a table."""
    keys = dict(each.split("=", 1) for each in arguments if "=" in each)
    for name, printed in (("table", table), ("brief", brief)):
        if name in keys:
            sys.stdout.write(printed(read_lines(keys[name])) + "\n")
            return
    (file,) = (each for each in arguments if "=" not in each)
    chosen: dict[str, Any] = {name: int(keys[name]) for name in ("tosses", "seed") if name in keys}
    chosen |= {"split": keys["split"]} if "split" in keys else {}
    chosen |= {"part": keys["part"]} if "part" in keys else {}
    run(read_dataset(file), Path(keys["out"]), threads=1, repeats=int(keys.get("repeats", 0)), **chosen)


if __name__ == "__main__":
    main(sys.argv[1:])
