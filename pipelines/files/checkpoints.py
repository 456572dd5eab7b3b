"""The trained model that a run keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pipelines.tracking.runs import RunRecord
    from tossid.models import TrainedModel


def trained_model(record: RunRecord) -> TrainedModel:
    """The trained model of a run.

    Args:
        record: The run.

    Raises:
        InputError: The run has no checkpoint, or it is damaged.
    """
    from tossid.models import TrainedModel

    return TrainedModel.load(record.weights())
