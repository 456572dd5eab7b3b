"""Training curves show every epoch that they were given."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from tests.evaluation.figures.reading import assert_legible, lines, titled, words
from tossid.errors import InputError
from tossid.evaluation.figures import training_curves


@dataclass
class Record:
    stage: str
    train_loss: float
    validation_loss: float
    parts: dict[str, float] = field(default_factory=dict)


def history() -> list[Record]:
    out = []
    for stage, n in (("continuous", 5), ("contact", 8)):
        for e in range(n):
            loss = 0.01 * 2.0**-e
            validation = loss * (3 if e == n - 1 else 1.5)
            parts = {"prediction": 0.7 * loss, "penetration": 0.3 * loss, "residual": 0.0, "unsolved": float(e == 2)}
            out.append(Record(stage, loss, validation, parts))
    return out


def test_training_curves_show_every_epoch_and_mark_stages() -> None:
    records = history()
    figure = training_curves(records)
    loss, parts = titled(figure, "Loss"), titled(figure, "Parts")
    for label, key in (("training", "train_loss"), ("validation", "validation_loss")):
        drawn = np.concatenate([one.get_ydata() for one in lines(loss, label)])
        np.testing.assert_allclose(drawn, [getattr(record, key) for record in records])
        assert len(lines(loss, label)) == 2, "stages are not joined"
    drawn = np.concatenate([one.get_ydata() for one in lines(parts, "prediction")])
    np.testing.assert_allclose(drawn, [record.parts["prediction"] for record in records])
    # the kept epochs are those of the lowest validation loss: the last but one of each stage
    assert [one.get_xdata()[0] for one in lines(loss, "_kept")] == [4, 12]
    assert {text.get_text().strip() for text in loss.texts} >= {"continuous", "contact", "training", "validation"}
    assert not lines(parts, "unsolved"), "a count is no part of the loss"
    assert "Unsolved inner problems: at most 1" in words(figure)
    assert_legible(figure)


def test_what_many_stages_kept_is_whole_below_the_curves() -> None:
    records = [replace(record, stage=f"stage {k} of the fit") for k in range(6) for record in history()[:3]]
    figure = training_curves(records)
    said = words(figure).replace("\n", " ")
    for k in range(6):
        assert f"stage {k} of the fit 0.00375 at epoch {3 * k + 3}" in said
    assert_legible(figure)


def test_names_of_short_last_stages_stay_in_the_axes() -> None:
    one = history()[0]
    records = [replace(one, stage="contact")] * 20 + [
        replace(one, stage="rollout-20"),
        replace(one, stage="rollout-90"),
    ]
    assert_legible(training_curves(records))


@pytest.mark.parametrize("n", [1, 2])
def test_training_curves_of_a_short_fit(n: int) -> None:
    assert_legible(training_curves(history()[:n]))


def test_training_curves_need_an_epoch() -> None:
    with pytest.raises(InputError, match="no epochs"):
        training_curves([])
