"""Print the name of the lock file that holds the torch which pip would install here, or "none".

Usage: python choose.py [ARGUMENTS OF PIP]
"""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

HERE = Path(__file__).parent


def main() -> str:
    """The lock's name: "cpu", "cuda" or "none"."""
    torch = re.findall(r"^torch==[\d.]+", (HERE / "cuda.txt").read_text(), re.MULTILINE)[0]
    report = ["--dry-run", "--quiet", "--ignore-installed", "--no-deps", "--report", "-", torch]
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", *report, *sys.argv[1:]], capture_output=True, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"pip finds no {torch} here:\n{done.stderr.strip()}")
    found = json.loads(done.stdout)["install"][0]
    sha256 = sha256_of(found["download_info"])
    for path in sorted(HERE.glob("*.txt")):
        if f"--hash=sha256:{sha256}" in path.read_text():
            return path.stem
    version = found["metadata"]["version"]
    print(  # noqa: T201
        f"no lock has this build of torch ({version}); packages are installed within the ranges of pyproject.toml",
        file=sys.stderr,
    )
    return "none"


def sha256_of(download: dict[str, Any]) -> str:
    """The hash of what pip would download. Of a file on this machine, older versions of pip do not say it.

    Args:
        download: pip's "download_info".
    """
    said = download["archive_info"].get("hashes", {}).get("sha256")
    if said is None:
        with open(url2pathname(urlsplit(download["url"]).path), "rb") as file:
            said = hashlib.file_digest(file, "sha256").hexdigest()
    return str(said)


if __name__ == "__main__":
    print(main())  # noqa: T201
