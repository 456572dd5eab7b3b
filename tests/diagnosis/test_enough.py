"""Of many tosses as many are searched as the answer needs: until other tosses agree with it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import pytest

from tests.diagnosis.by_hand import diagnosis, hypothesis
from tests.diagnosis.tossed import seen
from tossid.diagnosis.enough import disagreement, first_drawn, searched
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.engine_discrepancy import Engine
from tossid.diagnosis.localisation.unseen import Unseen
from tossid.diagnosis.result import Diagnosis
from tossid.diagnosis.selection.stability import Repeat, Stability
from tossid.diagnosis.sessions.explained import Explained
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.settings.diagnosis.diagnose import DiagnoseSettings, EnoughSettings
from tossid.types import Toss

FEW = DiagnoseSettings(enough=EnoughSettings(first=6, judges=8))


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube.with_changes(friction=0.3 + 0 * cube.friction)), cube, 26, seed=4)


def found(cube: ObjectModel, mu: float, closed: float) -> Diagnosis:
    made, half = diagnosis(cube), 0.01
    findings = (replace(made.findings[0], parameters={"mu": Interval(mu, mu - half, mu + half)}),)
    unseen = Unseen(8, Interval(9, 8, 10), Interval(1, 1, 1), Interval(closed, closed - 0.05, closed + 0.05))
    known = Interval(0.93, 0.9, 0.96)
    return replace(made, findings=findings, hypothesis=hypothesis(cube, friction=[mu]), unseen=unseen, gap_closed=known)


def test_other_tosses_confirm_the_truth_and_contradict_other_values(cube: ObjectModel, tosses: list[Toss]) -> None:
    def said(mu: float, closed: float) -> str:
        how = {"engine": Engine(none=True), "n_threads": 1, "settings": FEW}
        return disagreement(replace(found(cube, mu, closed), contact="own"), tosses[:6], **how)  # type: ignore[arg-type]

    assert said(0.3, 0.91) == ""
    assert "mu of friction was 0.2" in said(0.2, 0.91)
    assert "was 0.93, and 0.50" in said(0.3, 0.5)
    # (0.93 explains all, 0.84 to 0.94 may do so, and 0.78 to 0.88 surely does not)
    assert said(0.3, 0.89) == ""
    assert "was 0.93, and 0.83" in said(0.3, 0.83)


def test_twice_as_many_are_searched_until_others_agree(cube: ObjectModel, tosses: list[Toss]) -> None:
    asked: list[tuple[list[str], list[str]]] = []
    repeated: list[int] = []

    def search(part: Sequence[Toss], others: Sequence[Toss]) -> Explained:
        asked.append(([toss.name for toss in part], [toss.name for toss in others]))
        made = replace(found(cube, 0.2 if len(part) == 6 else 0.3, 0.91), contact="own")

        def repeat() -> Iterator[Diagnosis]:
            repeated.append(len(part))
            yield replace(made, stability=Stability((Repeat(("friction",), 0.9),)))

        return Explained(made, tuple(part), tuple(others), repeat)

    told: list[str] = []
    explained, remarks = searched(
        tosses, search, engine=Engine(none=True), n_threads=1, settings=FEW, under_way=UnderWay(news=told.append)
    )
    why, answer = told
    assert answer.startswith("the search names friction")
    assert why.startswith("With 6, mu of friction was 0.2")
    assert why.endswith("on others. 12 tosses are searched now")
    assert [len(names) for names, _ in asked] == [6, 12]
    assert [toss.name for toss in first_drawn(tosses, FEW)] == asked[0][0]
    assert [len(names) for _, names in asked] == [8, 12]
    assert [toss.name for toss in explained.tosses] == asked[1][0]
    assert repeated == [12]  # only the answer that stands still
    assert explained.diagnosis.stability.frequency(["friction"]) == 1.0
    for names, others in asked:
        assert not set(names) & set(others)
    assert set(asked[0][0]) < set(asked[1][0])
    assert remarks[0].startswith("12 of 26 tosses were searched")
    assert "With 6, mu of friction was 0.2" in remarks[0]


def test_few_tosses_and_a_stated_number_all_take_part(cube: ObjectModel, tosses: list[Toss]) -> None:
    def search(part: Sequence[Toss], others: Sequence[Toss]) -> Explained:
        assert not others
        made = found(cube, 0.3, 0.91)
        return Explained(made, tuple(part), (), lambda: iter(()))

    for some, settings in ((tosses[:11], FEW), (tosses, replace(FEW, tosses=26))):
        explained, remarks = searched(
            some, search, engine=Engine(none=True), n_threads=1, settings=settings, under_way=UnderWay()
        )
        assert explained.tosses == first_drawn(some, settings) == tuple(some)
        assert remarks == ()
