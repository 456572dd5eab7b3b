"""Start MLflow's server on the database of compose.yaml. The password comes from a file, and any password will do."""

from __future__ import annotations

import os
from pathlib import Path

from sqlalchemy import URL

SECRET = Path("/run/secrets/database")


def address(
    password: str, *, user: str = "mlflow", host: str = "database", port: int = 5432, name: str = "mlflow"
) -> str:
    """The database's address, with its password quoted.

    Args:
        password: As it is. It may hold "@", "/" and "%".
        user: Who connects.
        host: The database's machine.
        port: Its port there.
        name: The database's name.
    """
    url = URL.create("postgresql+psycopg2", user, password, host, port, name)
    return url.render_as_string(hide_password=False)


if __name__ == "__main__":
    # by the environment: arguments of a process can be read by others
    os.environ["MLFLOW_BACKEND_STORE_URI"] = address(SECRET.read_text().rstrip("\n"))
    os.execvp(
        "mlflow", ["mlflow", "server", "--artifacts-destination", "/artifacts", "--host", "0.0.0.0", "--port", "5000"]
    )
