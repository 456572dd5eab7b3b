"""Addresses of tracking servers, which may hold a password: it is printed, stored and logged nowhere."""

from __future__ import annotations

import os
import re
from urllib.parse import unquote, urlsplit

from tossid.errors import InputError

HIDDEN = "***"
_IN_ADDRESS = re.compile(r"([a-z][\w+.-]*://[^\s:/@'\"]*):[^\s'\"]*@", re.IGNORECASE)
_WHOLE = re.compile(r"([a-z][\w+.-]*://[^:/@]*):.*@", re.IGNORECASE | re.DOTALL)
_IN_QUERY = re.compile(r"([?&](?:password|passwd|pwd|sslpassword|token)=)[^&\s'\"]*", re.IGNORECASE)
_SECRETS = ("MLFLOW_TRACKING_PASSWORD", "MLFLOW_TRACKING_TOKEN")
_SHORTEST = 6
"""Characters of a secret that is replaced wherever it stands. A shorter one would also be a part of other words."""


def without_password(uri: str) -> str:
    """An address as it may be printed and stored: three asterisks for its password.

    Args:
        uri: The address. Its password may hold "@" and "/", though these should be written %40 and %2F.
    """
    return _IN_QUERY.sub(rf"\1{HIDDEN}", _WHOLE.sub(rf"\1:{HIDDEN}@", uri))


def redacted(text: str) -> str:
    """A text without the passwords of addresses in it, and without those that MLflow's variables hold.

    Args:
        text: What is to be printed or written.
    """
    uri = os.environ.get("MLFLOW_TRACKING_URI", "")
    if uri and uri in text:
        text = text.replace(uri, without_password(uri))
    text = _IN_QUERY.sub(rf"\1{HIDDEN}", _IN_ADDRESS.sub(rf"\1:{HIDDEN}@", text))
    for secret in _secrets(uri):
        if len(secret) >= _SHORTEST:
            text = text.replace(secret, HIDDEN)
    return text


def _secrets(uri: str) -> set[str]:
    found = {os.environ.get(name, "") for name in _SECRETS}
    hidden = _WHOLE.match(uri)
    if hidden:
        password = uri[hidden.end(1) + 1 : hidden.end() - 1]
        found |= {password, unquote(password)}
    return found


def check_address(uri: str) -> None:
    """Refuse an address whose password cannot be distinguished from its host.

    Args:
        uri: Of a server, a database or a file.

    Raises:
        InputError: A "@" or "/" in its password is not percent-encoded.
    """
    parts = urlsplit(uri)
    if parts.netloc and ("@" in parts.path or parts.netloc.count("@") > 1):
        problem = "'@' and '/' in a user's name or password are written %40 and %2F"
        raise InputError(f"MLFLOW_TRACKING_URI={without_password(uri)}: {problem}")


def is_server(uri: str) -> bool:
    """Whether an address is that of a tracking server."""
    return uri.startswith(("http://", "https://"))


def is_database(uri: str) -> bool:
    """Whether an address is that of a database on a server."""
    return uri.partition(":")[0].partition("+")[0] in ("postgresql", "postgres", "mysql", "mssql")
