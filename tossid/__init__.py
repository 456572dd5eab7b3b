"""Learn an object's contact and continuous dynamics from its tosses, and find where a simulator differs from them.

    import tossid

    dataset = tossid.ingest("data/raw/mine", object="cube")
    model = tossid.train(dataset, model="cnrpi", gravity=0.0)
    scores = tossid.evaluate(model, dataset.split("test"))
    gap = tossid.diagnose(dataset, simulator="nominal")
    gap.save("gap/")

Every name below is imported when it is first used, so that `import tossid` itself stays quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from tossid.first_use import imported_at_first_use

if TYPE_CHECKING:
    from tossid.diagnosis.diagnose import diagnose as diagnose
    from tossid.diagnosis.result import Diagnosis as Diagnosis
    from tossid.errors import TossidError as TossidError
    from tossid.evaluation.evaluate import Scores as Scores
    from tossid.evaluation.evaluate import evaluate as evaluate
    from tossid.evaluation.export import Exported as Exported
    from tossid.evaluation.export import export as export
    from tossid.ingestion.ingest import ingest as ingest
    from tossid.models.trained import TrainedModel as TrainedModel
    from tossid.objects import ObjectModel as ObjectModel
    from tossid.settings.diagnosis.diagnose import DiagnoseSettings as DiagnoseSettings
    from tossid.settings.evaluation import EvaluateSettings as EvaluateSettings
    from tossid.settings.ingestion import IngestSettings as IngestSettings
    from tossid.settings.synthesis import SynthesizeSettings as SynthesizeSettings
    from tossid.settings.training import TrainSettings as TrainSettings
    from tossid.store import Dataset as Dataset
    from tossid.store import read_dataset as read_dataset
    from tossid.store import write_dataset as write_dataset
    from tossid.studies.result import Study as Study
    from tossid.studies.study import study as study
    from tossid.synthesis.synthesize import synthesize as synthesize
    from tossid.training.api import train as train
    from tossid.types import Rollout as Rollout
    from tossid.types import Toss as Toss

_HOMES = {
    "ingest": "tossid.ingestion.ingest",
    "read_dataset": "tossid.store",
    "write_dataset": "tossid.store",
    "synthesize": "tossid.synthesis.synthesize",
    "train": "tossid.training.api",
    "evaluate": "tossid.evaluation.evaluate",
    "study": "tossid.studies.study",
    "diagnose": "tossid.diagnosis.diagnose",
    "export": "tossid.evaluation.export",
    "Dataset": "tossid.store",
    "Toss": "tossid.types",
    "Rollout": "tossid.types",
    "ObjectModel": "tossid.objects",
    "TrainedModel": "tossid.models.trained",
    "Scores": "tossid.evaluation.evaluate",
    "Study": "tossid.studies.result",
    "Diagnosis": "tossid.diagnosis.result",
    "Exported": "tossid.evaluation.export",
    "IngestSettings": "tossid.settings.ingestion",
    "SynthesizeSettings": "tossid.settings.synthesis",
    "TrainSettings": "tossid.settings.training",
    "EvaluateSettings": "tossid.settings.evaluation",
    "DiagnoseSettings": "tossid.settings.diagnosis.diagnose",
    "TossidError": "tossid.errors",
}
"""The public names, and the module that defines each."""
_ROOMS = (
    "errors",
    "rotations",
    "settings",
    "types",
    "objects",
    "store",
    "physics",
    "motion",
    "vision",
    "synthesis",
    "models",
    "training",
    "evaluation",
    "studies",
    "diagnosis",
)

__all__ = [*_HOMES, *_ROOMS]

if not TYPE_CHECKING:
    _name = imported_at_first_use(__name__, _HOMES)

    def __getattr__(name: str) -> Any:
        """A public name or a room, imported now (PEP 562)."""
        return importlib.import_module(f"tossid.{name}") if name in _ROOMS else _name(name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
