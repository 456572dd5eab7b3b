"""The experiment's cases: a right effect is not refused, and one without what acts against it is."""

from __future__ import annotations

import pytest

from pipelines.tools.experiments import refusal


@pytest.mark.filterwarnings("ignore:the contact problem missed its tolerance")
@pytest.mark.parametrize(("name", "refused"), [("both", 0), ("adhesion without a bounce of 0.3", 1)])
def test_what_makes_whole_tosses_worse_is_refused(name: str, refused: int) -> None:
    cells = [cell.strip() for cell in refusal.line(name, judges=24, draws=1, seed=8).strip("| ").split("|")]
    assert cells[0] == name
    assert cells[4] == f"{refused} of 1"
