"""`tossid synthesize`: tosses from a simulator, as camera frames or as states, with their truth beside."""

from __future__ import annotations

import warnings
from typing import Any

from pipelines.cli.console import Console
from pipelines.config.compose import part_of
from pipelines.config.schemas import SynthesizeConfig
from pipelines.execution.code_version import commit, version
from pipelines.files.project import RECORDINGS
from tossid.settings.synthesis import SynthesizeSettings


def run(config: SynthesizeConfig, console: Console) -> dict[str, Any]:
    """Simulate, then write frames or states; returns what was made."""
    from tossid.store import file_sha256
    from tossid.synthesis.synthesize import TOSSES, TRUTH, synthesize

    out = config.out or RECORDINGS / f"{config.object.name}-{config.engine.name}-{config.seed}"
    settings = part_of(config, SynthesizeSettings)
    about = f"tossing '{config.object.name}' {config.tosses} times with engine {config.engine.name}"
    if config.effects:
        about += f" and effects {', '.join(config.effects)}"
    with warnings.catch_warnings(record=True) as problems, console.shares(about) as progress:
        made = synthesize(
            config.object,
            frames=config.frames,
            out=out,
            settings=settings,
            progress=progress,
            provenance={"command": "tossid synthesize", "version": version(), "commit": commit()},
        )
    for problem in problems:
        console.warn(str(problem.message))
    result = {
        "out": str(out),
        "object": made.object.name,
        "engine": config.engine.name,
        "n_tosses": len(made.tosses),
        "n_frames": sum(len(toss) for toss in made.tosses),
        "rate_hz": made.rate_hz,
        "seed": config.seed,
        "unsolved_steps": made.provenance["unsolved_steps"],
        "truth": str(out / TRUTH),
        "truth_sha256": file_sha256(out / TRUTH),
    }
    if config.frames:
        from tossid.vision.recordings.formats.frames import read_recording

        recording = read_recording(out)
        result |= {"n_images": recording.n_frames, "cameras": tuple(camera.name for camera in recording.cameras)}
    else:
        result |= {"dataset": str(out / TOSSES), "n_images": 0}
    console.facts(result, title=f"wrote {out}")
    then = "tossid ingest" if config.out is None else f"tossid ingest source.path={out}"
    console.say(f"next: {then}" if config.frames else f"next: tossid train data={out / TOSSES}")
    return result
