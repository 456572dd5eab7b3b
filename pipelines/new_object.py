"""`tossid new-object`: an object from a box and a tag on each of its faces, and the sheet to print the tags from."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.console import Console
from pipelines.keys import CONF
from pipelines.outputs import output_file
from pipelines.schemas import NewObjectConfig
from tossid.errors import ConfigError, FileError

if TYPE_CHECKING:
    from tossid.objects import ObjectModel

MJCF = """<mujoco model="{name}">
  <worldbody>
    <body name="{name}">
      <freejoint/>
      <inertial pos="{com}" mass="{mass!r}" diaginertia="{inertia}"/>
      <geom type="box" size="{half}"/>
    </body>
  </worldbody>
</mujoco>
"""


def run(config: NewObjectConfig, console: Console) -> dict[str, Any]:
    """Make it; returns the files, the tags' ids and sizes, and the key that takes it."""
    import yaml

    from tossid.vision.layout import Body, TagLayout, body_tags
    from tossid.vision.tag_sheet import tag_sheets
    from tossid.vision.tagslam import write_tagslam

    folder = config.out or CONF
    files = {
        "model": folder / "object" / f"{config.name}.xml",
        "object": folder / "object" / f"{config.name}.yaml",
        "tags": folder / "tags" / f"{config.name}.yaml",
        "sheet": folder / "tags" / f"{config.name}.pdf",
    }
    text = _mjcf(config)
    _check(config, files, text)
    model = _tagged(config, text)
    sheets = tag_sheets(model, paper=config.paper)
    values = {
        "name": config.name,
        "path": _named(files["model"]),
        "friction": config.friction,
        "restitution": config.restitution,
        "width": max(config.box),
        "tags": _named(files["tags"]),
    }
    with output_file(files["model"]) as temporary:
        temporary.write_text(text)
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


def _check(config: NewObjectConfig, files: dict[str, Path], text: str) -> None:
    if not re.fullmatch(r"[A-Za-z][\w-]*", config.name, re.ASCII):
        raise ConfigError("name", f"'{config.name}' will not do; expected letters, digits, '_' and '-'.")
    there = next((path for path in files.values() if path.exists()), None)
    # written in this order: the same model without an object is what a killed command has left
    left = there == files["model"] and not files["object"].exists() and there.read_text(errors="replace") == text
    if there is not None and not left:
        raise FileError(there, "is there already; choose another name, or remove it")
    if any(abs(c) >= edge / 2 for c, edge in zip(config.com, config.box, strict=True)):
        raise ConfigError("com", f"{list(config.com)} lies outside the box; expected metres from its centre.")


def _named(path: Path) -> str:
    """A path as conf's objects name theirs: from tossid's own folder where it is there."""
    return str(path.relative_to(CONF.parent) if path.is_relative_to(CONF.parent) else path)


def _mjcf(config: NewObjectConfig) -> str:
    """The box with the inertia that it has if its mass is spread evenly."""
    x, y, z = config.box
    inertia = (config.mass / 12 * s for s in (y * y + z * z, x * x + z * z, x * x + y * y))
    return MJCF.format(
        name=config.name,
        mass=config.mass,
        com=_row(config.com),
        inertia=_row(inertia),
        half=_row(edge / 2 for edge in config.box),
    )


def _row(values: Any) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _tagged(config: NewObjectConfig, text: str) -> ObjectModel:
    from dataclasses import replace

    from tossid.objects import object_from_mjcf
    from tossid.vision.faces import default_tags
    from tossid.vision.tag_sheet import QUIET

    model = object_from_mjcf(text)
    tags = default_tags(model, first_id=config.first_id)
    if config.tag_size is not None:
        room = sorted(config.box)[0] / QUIET
        if config.tag_size > room:
            problem = f"{config.tag_size:g} leaves no white margin on the smallest face; expected at most {room:.4g}."
            raise ConfigError("tag_size", problem)
        tags = tuple(replace(tag, size=config.tag_size) for tag in tags)
    return replace(model, name=config.name, tags=tags)


def _write_pdf(sheets: list[Any], path: Path) -> None:
    from matplotlib.backends.backend_pdf import PdfPages

    with PdfPages(path, metadata={"Title": "AprilTags, to be printed at 100 %", "Creator": "tossid"}) as pdf:
        for sheet in sheets:
            pdf.savefig(sheet)
