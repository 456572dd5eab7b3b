"""Small files that claim much are refused through the command line, in 2 s and 500 MB, with the file and the claim."""

from __future__ import annotations

import json
import subprocess
import sys

from tests.conftest import ROOT
from tests.fuzz.claims import CLAIMS


def test_each_small_file_with_a_huge_claim_is_refused_fast_and_in_little_memory() -> None:
    command = [sys.executable, "-m", "tests.fuzz.measure_claims", "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout)
    assert set(measured) == set(CLAIMS)
    for name, each in measured.items():
        (line,) = each["said"].strip().splitlines()
        assert each["code"] == 2, (name, line)
        assert CLAIMS[name].names in line, (name, line)
        assert CLAIMS[name].says in line, (name, line)
        assert each["seconds"] < 2, (name, each)
        assert each["megabytes"] < 500, (name, each)
        assert each["bytes"] < 5 << 20, name
