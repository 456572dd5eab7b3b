"""Texts that a person has read once, kept beside the test that compares with them."""

from __future__ import annotations

import os
from pathlib import Path


def assert_as_read(path: Path, text: str) -> None:
    """Compare with the kept file. WRITE_GOLDEN=1 writes it anew, to be read as a diff and committed."""
    if os.environ.get("WRITE_GOLDEN"):
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8"), f"{path.name} reads otherwise; WRITE_GOLDEN=1 shows it as a diff"
