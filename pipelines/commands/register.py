"""`tossid register`: a trained model under a name in MLflow's registry, as its next version."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from pipelines.cli.console import Console
from pipelines.config.schemas import RegisterConfig
from tossid.errors import InputError


def run(config: RegisterConfig, console: Console) -> dict[str, Any]:
    """Register; returns name, version and how to name it in other commands."""
    from mlflow.exceptions import MlflowException

    from pipelines.tracking.mlflow_store import client
    from pipelines.tracking.registry import write_model
    from pipelines.tracking.runs import find_run

    record = find_run(config.run)
    if not record.id:
        raise InputError(f"run={config.run}: no run of MLflow stands behind this folder; name one by its id")
    store = client()
    with tempfile.TemporaryDirectory() as folder:
        signature = write_model(record.weights(), Path(folder) / "model")
        store.log_artifacts(record.id, f"{folder}/model", "model")
    try:
        store.create_registered_model(config.name)
    except MlflowException as error:
        if error.error_code != "RESOURCE_ALREADY_EXISTS":
            raise
    source = f"{store.get_run(record.id).info.artifact_uri}/model"
    version = store.create_model_version(config.name, source, run_id=record.id).version
    address = f"models:/{config.name}/{version}"
    console.facts({"run": record.id, "use": f"tossid evaluate run={address}"}, title=address)
    shape = {"inputs": signature.inputs.to_dict(), "outputs": signature.outputs.to_dict()}
    return {"name": config.name, "version": int(version), "model": address, "run": record.id, "signature": shape}
