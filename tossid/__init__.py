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

from typing import TYPE_CHECKING

from tossid.first_use import imported_at_first_use

if TYPE_CHECKING:
    from tossid.diagnosis.diagnose import diagnose
    from tossid.diagnosis.result import Diagnosis
    from tossid.errors import TossidError
    from tossid.evaluation.evaluate import Scores, evaluate
    from tossid.evaluation.export import Exported, export
    from tossid.ingestion.ingest import ingest
    from tossid.models.trained import TrainedModel
    from tossid.objects import ObjectModel
    from tossid.settings.diagnosis.diagnose import DiagnoseSettings
    from tossid.settings.evaluation import EvaluateSettings
    from tossid.settings.ingestion import IngestSettings
    from tossid.settings.synthesis import SynthesizeSettings
    from tossid.settings.training import TrainSettings
    from tossid.store import Dataset, read_dataset, write_dataset
    from tossid.studies.result import Study
    from tossid.studies.study import study
    from tossid.synthesis.synthesize import synthesize
    from tossid.training.api import train
    from tossid.types import Rollout, Toss
else:
    __all__, __getattr__, __dir__ = imported_at_first_use(__name__)
