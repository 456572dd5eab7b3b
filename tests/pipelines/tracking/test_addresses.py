"""No password of a tracking address is in what is printed or written."""

from __future__ import annotations

import pytest

from pipelines.tracking.addresses import redacted, without_password


@pytest.mark.parametrize(
    ("uri", "shown"),
    [
        ("http://ann:s3cret@lab:5000", "http://ann:***@lab:5000"),
        ("postgresql+psycopg2://ann:p%40ss%2Fw@lab/runs", "postgresql+psycopg2://ann:***@lab/runs"),
        ("postgresql://ann:p@ss/w@lab/runs", "postgresql://ann:***@lab/runs"),
        ("postgresql://lab/runs?user=ann&password=s3cret", "postgresql://lab/runs?user=ann&password=***"),
        ("http://lab:5000", "http://lab:5000"),
        ("postgresql://ann@lab/runs", "postgresql://ann@lab/runs"),
        ("sqlite:////data/a@b/mlflow.db", "sqlite:////data/a@b/mlflow.db"),
        ("", ""),
    ],
)
def test_an_address_without_its_password(uri: str, shown: str) -> None:
    assert without_password(uri) == shown


@pytest.mark.parametrize("uri", ["http://ann:pl%40nt%2Fed@lab:5000", "http://ann:planted@lab:5000"])
def test_a_text_about_an_address(uri: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    text = f"API request to {uri}/api failed; mail ann@lab; login failed for 'pl@nt/ed' or 'planted'"
    shown = redacted(text)
    assert "API request to http://ann:***@lab:5000/api failed; mail ann@lab;" in shown
    assert "ed@lab" not in shown
    assert ("planted" in shown) == ("%40" in uri)
    assert ("pl@nt/ed" in shown) == ("%40" not in uri)


def test_variables_that_hold_a_secret(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_TOKEN", "tok-12345")
    assert redacted("Authorization: Bearer tok-12345") == "Authorization: Bearer ***"
