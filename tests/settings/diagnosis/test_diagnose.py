"""A setting of a part of the diagnosis is changed by its name, wherever it is."""

from __future__ import annotations

from tossid.diagnosis.likelihood.windows import steps_of
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.settings.changed import changed
from tossid.settings.contact import ContactSettings
from tossid.settings.diagnosis.diagnose import DiagnoseSettings


def test_parts_are_changed_by_name() -> None:
    settings = changed(
        DiagnoseSettings(), {"degrees_of_freedom": 5.0, "likelihood__simulation__substeps": 3, "seed": 3}
    )
    assert settings.likelihood.density.degrees_of_freedom == 5.0
    assert settings.likelihood.simulation.substeps == 3
    assert settings.likelihood.windows == DiagnoseSettings().likelihood.windows
    assert settings.seed == 3


def test_the_thresholds_of_contact_reach_the_simulator_of_windows(cube: ObjectModel) -> None:
    settings = changed(DiagnoseSettings(), {"bounce_speed": 0.05}).likelihood.simulation
    assert steps_of(World(cube), settings)["contact"] == ContactSettings(bounce_speed=0.05)
