"""The trained model that a run keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tossid.errors import InputError

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

    if record.checkpoint is None:
        raise InputError(f"run {record.name} ({record.id or record.folder}) has no checkpoint")
    return TrainedModel.load(record.checkpoint)
