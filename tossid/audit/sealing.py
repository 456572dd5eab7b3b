"""The truth of a case, sealed before its diagnosis: unreadable, elsewhere, and with its hash published."""

from __future__ import annotations

import hashlib
import json
import secrets
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tossid.errors import FileError
from tossid.plain_json import jsonable

TRUTH, SEAL, SEALS = "truth.json", "seal.txt", "seals.txt"
"""Names of files: the unsealed truth and its hash in a case's folder, and all hashes in that of the audit."""


def seal(truth: Mapping[str, Any], name: str, out: Path, folder: Path) -> Path:
    """Put the truth where a diagnosis does not look, unreadable, and publish its hash; returns the sealed file.

    A random number is sealed with it, which keeps anyone from finding a short truth by trying.

    Args:
        truth: The truth.
        name: The case.
        out: The audit's folder; the truth goes to .sealed there, the hash to seals.txt.
        folder: The case's folder; the hash goes to seal.txt there.
    """
    content = json.dumps(jsonable({**truth, "nonce": secrets.token_hex(16)}), indent=1, sort_keys=True).encode()
    sha256 = hashlib.sha256(content).hexdigest()
    path = out / ".sealed" / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    path.write_bytes(content)
    path.chmod(0)
    (folder / SEAL).write_text(f"{sha256}\n")
    with (out / SEALS).open("a") as file:
        file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())} {name} {sha256}\n")
    return path


def unseal(path: Path, folder: Path) -> None:
    """Move the truth beside the diagnosis.

    Args:
        path: The sealed file; it is removed.
        folder: The case's folder.

    Raises:
        FileError: It is not what was sealed.
    """
    path.chmod(0o600)
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != (folder / SEAL).read_text().strip():
        raise FileError(path, f"is not what was sealed; {SEAL} has another SHA-256")
    (folder / TRUTH).write_bytes(content)
    path.unlink()
