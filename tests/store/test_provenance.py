"""A dataset says which call made it, with which settings."""

from __future__ import annotations

import json

import numpy as np
import yaml

from tossid.settings.synthesis import SynthesizeSettings
from tossid.store.provenance import provenance_of


def test_the_settings_can_be_read_back() -> None:
    made = provenance_of(
        "tossid.synthesize", SynthesizeSettings(tosses=3, effects={"wind": {"x_ms": 1.0}}), object="cube"
    )
    config = yaml.safe_load(str(made["config"]))
    assert made["command"] == "tossid.synthesize"
    assert json.loads(str(made["versions"]))["numpy"] == np.__version__
    assert (config["object"], config["tosses"], config["effects"]) == ("cube", 3, {"wind": {"x_ms": 1.0}})
    assert config["splits"] == [0.5, 0.3, 0.2]
