"""Fuzzing guided by coverage: `make fuzz SECONDS=600`, or `python -m tests.fuzz.run tum mjcf --seconds 600`.

libFuzzer (by atheris) changes a valid file as long as something new happens in tossid's readers, and puts huge numbers
into it (`claims.dict`). It stops at the first finding: an exception that is no `TossidError`, more than 5 s, more than
1 GiB of memory, or 256 MiB that are not given back. The file that did it is left in outputs/fuzz/TARGET; kept in
tests/fuzz/findings/TARGET, it is a test. What was tried is gone on from next time.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import resource
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

OUT = Path("outputs/fuzz")
MEMORY = 2**30
KEPT = 2**28
"""Bytes that reading a file may leave taken."""
TOO_LONG_S = 5
CLAIMS = Path(__file__).parent / "claims.dict"
"""Huge numbers that libFuzzer puts into files."""
LARGEST = 2**19
"""Bytes of a file."""


def fuzz(name: str, seconds: int) -> None:
    """Fuzz one target in this process, which ends with it."""
    import atheris

    with atheris.instrument_imports(include=["tossid", "pipelines"], enable_loader_override=False):
        from tests.fuzz.targets import TARGETS
        from tossid.errors import TossidError

    target, corpus = TARGETS[name], OUT / name / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")
    logging.disable()
    with tempfile.TemporaryDirectory() as folder:
        file = target.make(Path(folder))
        (corpus / "valid").write_bytes(file.read_bytes())
        target.read(file)
        resource.setrlimit(resource.RLIMIT_AS, (_taken() + MEMORY, resource.RLIM_INFINITY))

        def once(content: bytes) -> None:
            file.write_bytes(content)
            before = _taken()
            with contextlib.suppress(TossidError):
                target.read(file)
            if _taken() > before + KEPT:
                raise MemoryError(f"{_taken() - before} bytes are not given back")

        limits = [
            f"-max_total_time={seconds}",
            f"-timeout={TOO_LONG_S}",
            f"-max_len={LARGEST}",
            "-rss_limit_mb=0",
            f"-dict={CLAIMS}",
        ]
        atheris.Setup([sys.argv[0], *limits, f"-artifact_prefix={OUT / name}/", "-verbosity=0", str(corpus)], once)
        atheris.Fuzz()


def _taken() -> int:
    """This process's address space in bytes."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def main() -> None:
    """Each target named, or all, in a process of its own; 1 if there was a finding."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*")
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--here", action="store_true", help="in this process")
    asked = parser.parse_args()
    if asked.here:
        fuzz(asked.targets[0], asked.seconds)
        return
    from tests.fuzz.targets import TARGETS

    failed = []
    for name in asked.targets or TARGETS:
        log = OUT / name / "log.txt"
        log.parent.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "tests.fuzz.run", name, "--here", "--seconds", str(asked.seconds)]
        with log.open("w") as stream:
            status = subprocess.run(command, stdout=stream, stderr=subprocess.STDOUT).returncode
        tried = len(list((OUT / name / "corpus").iterdir()))
        said = f"a finding, see {log}" if status else f"nothing found, {tried} files in the corpus"
        print(f"{name}: {said}", flush=True)
        failed += [name] if status else []
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
