"""Where a dataset comes from, as its file says."""

from __future__ import annotations

import json

import yaml

from pipelines.config.compose import load
from pipelines.config.schemas import IngestConfig
from pipelines.files.datasets import provenance


def test_keys_that_leave_the_data_as_they_are_do_not_count() -> None:
    keys = ["source=tum", "source.path=a"]
    one = provenance("ingest", load("ingest", IngestConfig, [*keys, "out=a.h5"]), {"source_sha256": "ab"})
    other = provenance(
        "ingest", load("ingest", IngestConfig, [*keys, "out=b.h5", "threads=1"]), {"source_sha256": "ab"}
    )
    assert one == other
    assert one["command"] == "tossid ingest"
    assert one["source_sha256"] == "ab"
    assert yaml.safe_load(str(one["config"]))["source"]["path"] == "a"
    assert {"python", "numpy"} <= json.loads(str(one["versions"])).keys()
