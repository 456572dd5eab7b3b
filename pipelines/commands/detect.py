"""`tossid detect`: tags in a recording's frames, to a file; of many recordings, by workers."""

from __future__ import annotations

import glob
import json
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pipelines.cli.console import Console, reported
from pipelines.config.compose import as_plain
from pipelines.config.schemas import DetectStageConfig
from pipelines.execution.workers import submitting
from pipelines.files.open_source import DETECTIONS, STAGES, open_stage, stage_file
from pipelines.files.project import named
from tossid.code_digest import code_digest
from tossid.errors import ConfigError, InputError, TossidError
from tossid.ingestion import stages
from tossid.ingestion.progress import Reporter
from tossid.objects import absolute_paths
from tossid.outputs import output_file
from tossid.parallel import as_done
from tossid.plain_json import digest_of, jsonable
from tossid.store import source_sha256
from tossid.vision.recordings.npz import write_detections
from tossid.vision.recordings.registry import recording_name

DONE = "detections.json"
"""What was found in a recording in short: the sign that it need not be searched again."""


def run(config: DetectStageConfig, console: Console) -> dict[str, Any]:
    """Detect, write; returns counts and `out`, of many recordings in a list."""
    if config.recordings is not None:
        return _run_many(config, config.recordings, console)
    opened = open_stage(config.recording, config.object)
    n_images = opened.images().n_frames
    out = named("out", config.out or stage_file(opened, DETECTIONS), ".npz")
    tally: Counter[str] = Counter()
    with output_file(out) as temporary, reported(console) as progress:
        found = stages.detect(
            opened, settings=config.detect, threads=config.threads, tally=tally, report=Reporter(progress)
        )
        write_detections(found, temporary)
    counts = stages.counts(tally)
    console.facts(counts, title=f"wrote {out}")
    return {
        "out": str(out),
        "recording": str(opened.path),
        "object": opened.model.name if opened.model is not None else None,
        "n_images": n_images,
        "n_detections": counts["tags"],
        "counts": counts,
    }


# ---------------------------------------------------------------- many recordings


def _run_many(config: DetectStageConfig, pattern: str, console: Console) -> dict[str, Any]:
    """Every recording by itself: one that cannot be read does not keep the others from it, and what is done stays."""
    each = _recordings(config, pattern)
    rows = {one.out: row for one in each if (row := _stored(one)) is not None}
    console.say(f"{pattern}: {len(rows)} of {len(each)} recordings are done")
    missing, failed = [one for one in each if one.out not in rows], []
    with console.progress("detect", len(each), unit="recordings") as bar:
        bar.advance(len(rows))
        with submitting(config.launcher, config.workers, len(missing)) as submit:
            for one, outcome in as_done(_detected, missing, submit):
                if isinstance(outcome, TossidError):
                    failed.append({"recording": str(one.recording), "error": str(outcome)})
                    console.warn(str(outcome))
                else:
                    rows[one.out] = outcome
                bar.advance(1, note=Path(str(one.recording)).name)
    if not rows:
        raise InputError(f"all {len(failed)} recordings failed; the first: {failed[0]['error']}")
    found = [rows[one.out] for one in each if one.out in rows]
    for row in found:
        console.say(f"{row['recording']}: {row['n_detections']} tags in {row['n_images']} images, in {row['out']}")
    return {"recordings": found, "failed": failed}


def _recordings(config: DetectStageConfig, pattern: str) -> list[DetectStageConfig]:
    """The keys for each of the recordings, with whole paths: workers may be in another folder.

    Raises:
        ConfigError: keys that do not go together, a pattern that nothing fits, or recordings of one name.
    """
    for key in ("recording", "threads"):
        if getattr(config, key) is not None:
            raise ConfigError(key, "is for one recording; leave it out beside recordings=.")
    paths = [Path(text).resolve() for text in sorted(glob.glob(pattern))]
    if not paths:
        raise ConfigError("recordings", f"nothing fits '{pattern}'; expected a pattern of paths, as 'data/raw/*'.")
    names = [recording_name(path) for path in paths]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ConfigError("recordings", f"several are named '{twice[0]}', and would be written to one place.")
    folder = (config.out or STAGES).absolute()
    given = None if config.object is None else absolute_paths(config.object)
    one = replace(config, recordings=None, object=given, threads=1)
    return [
        replace(one, recording=path, out=folder / name / DETECTIONS) for path, name in zip(paths, names, strict=True)
    ]


def _detected(one: DetectStageConfig) -> dict[str, Any]:
    """What a worker does."""
    assert one.out is not None
    digest = _digest(one)
    row = dict(jsonable(run(one, Console(quiet=True))))
    with output_file(one.out.with_name(DONE)) as temporary:
        temporary.write_text(json.dumps({"digest": digest, "row": row}, indent=1) + "\n")
    return row


def _stored(one: DetectStageConfig) -> dict[str, Any] | None:
    """What was found in a recording, if it was searched in the same way and has not changed."""
    assert one.out is not None
    try:
        found = json.loads(one.out.with_name(DONE).read_text())
        same = one.out.is_file() and found["digest"] == _digest(one)
        return dict(found["row"]) if same else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _digest(one: DetectStageConfig) -> str:
    """Of all that detections depend on."""
    assert one.recording is not None
    inputs = {
        "recording": source_sha256(one.recording),
        "object": None if one.object is None else asdict(one.object),
        "detect": as_plain(one.detect),
        "code": code_digest(),
    }
    return digest_of(inputs)
