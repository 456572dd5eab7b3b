"""`tossid new-object`: an object from a box and a tag on each of its faces, and the sheet to print the tags from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.cli.console import Console
from pipelines.config.places import OWN_CONF
from pipelines.config.schemas import NewObjectConfig
from tossid.errors import ConfigError, FileError
from tossid.outputs import output_file

if TYPE_CHECKING:
    from tossid.objects import ObjectModel


LARGEST_EDGE = 3.0
"""Of an object that a person tosses [m]: more is in another unit."""


def run(config: NewObjectConfig, console: Console) -> dict[str, Any]:
    """Make it; returns the files, the tags' ids and sizes, and the key that takes it."""
    import yaml

    from tossid.vision.setup.layout import Body, TagLayout, body_tags
    from tossid.vision.setup.tag_sheet import tag_sheets
    from tossid.vision.setup.tagslam import write_tagslam

    folder = config.out or OWN_CONF
    files = {
        "model": folder / "object" / f"{config.name}.xml",
        "object": folder / "object" / f"{config.name}.yaml",
        "tags": folder / "tags" / f"{config.name}.yaml",
        "sheet": folder / "tags" / f"{config.name}.pdf",
    }
    model = _tagged(config)
    _refuse_existing(files, model.mjcf)
    sheets = tag_sheets(model, paper=config.paper)
    values = {
        "name": config.name,
        "path": str(files["model"]),
        "friction": config.friction,
        "restitution": config.restitution,
        "width": model.width,
        "tags": str(files["tags"]),
    }
    with output_file(files["model"]) as temporary:
        temporary.write_text(model.mjcf)
    with output_file(files["tags"]) as temporary:
        write_tagslam(TagLayout((Body(config.name, False, tags=body_tags(model, 0)),)), temporary)
    with output_file(files["sheet"]) as temporary:
        _write_pdf(sheets, temporary)
    with output_file(files["object"]) as temporary:  # the last: who finds it finds all
        temporary.write_text(f"# Made by tossid new-object.\n{yaml.safe_dump(values, sort_keys=False)}")
    key = f"object={config.name}"
    if config.out is not None:
        key = f"object=custom object.name={config.name} object.path={files['model']} object.tags={files['tags']}"
    sizes = {tag.id: tag.size for tag in model.tags}
    console.facts(
        {
            "object": files["object"],
            "print": f"{files['sheet']} ({len(sheets)} pages), at 100 %",
            "use": f"tossid ingest source.path=FOLDER {key}",
        },
        title=f"{config.name}: {len(sizes)} tags, ids {min(sizes)} to {max(sizes)}",
    )
    return {"object": config.name, **files, "pages": len(sheets), "tag_sizes_m": sizes, "key": key}


def _refuse_existing(files: dict[str, Path], text: str) -> None:
    """Refuse to write over an object. The same model without its object.yaml is what a killed command has left."""
    there = next((path for path in files.values() if path.exists()), None)
    left = there == files["model"] and not files["object"].exists() and there.read_text(errors="replace") == text
    if there is not None and not left:
        raise FileError(there, "is there already; choose another name, or remove it")


def _tagged(config: NewObjectConfig) -> ObjectModel:
    """The box with a tag on each face."""
    from tossid.objects import box
    from tossid.vision.setup.faces import default_tags
    from tossid.vision.setup.tag_sheet import QUIET

    if max(config.box) > LARGEST_EDGE:
        metres = ",".join(f"{edge / 1000:g}" for edge in config.box)
        problem = f"{max(config.box):g} m is no edge of an object to toss; expected metres: [{metres}] if these are mm."
        raise ConfigError("box", problem)
    model = box(config.name, config.box, config.mass, com=config.com, friction=config.friction)
    tags = default_tags(model, first_id=config.first_id)
    if config.tag_size is not None:
        room = sorted(config.box)[0] / QUIET
        if config.tag_size > room:
            problem = f"{config.tag_size:g} leaves no white margin on the smallest face; expected at most {room:.4g}."
            raise ConfigError("tag_size", problem)
        tags = tuple(replace(tag, size=config.tag_size) for tag in tags)
    return replace(model, tags=tags)


def _write_pdf(sheets: list[Any], path: Path) -> None:
    from matplotlib.backends.backend_pdf import PdfPages

    with PdfPages(path, metadata={"Title": "AprilTags, to be printed at 100 %", "Creator": "tossid"}) as pdf:
        for sheet in sheets:
            pdf.savefig(sheet)
