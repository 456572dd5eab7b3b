"""Where `conf/` and the sample recording lie: in a clone, in an installed package, and in the folder of the user."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
_CLONE = _PACKAGE.parent


def _shipped(in_package: str, in_clone: str) -> Path:
    """A folder that a wheel carries inside the package and a clone has at its top."""
    inside = _PACKAGE / in_package
    return inside if inside.is_dir() else _CLONE / in_clone


CONF = _shipped("conf", "conf")
"""The values that ship with tossid."""

SAMPLE = _shipped("sample", "data/raw/sample")
"""The recording that ships with tossid."""

OWN_CONF = Path("conf")
"""Further members of groups, in the folder that a command is run in: `conf/object/NAME.yaml` and the like."""


def folders() -> tuple[Path, ...]:
    """The folders in which a member of a group is sought: that of tossid, and behind it the user's own, if any."""
    own = OWN_CONF.absolute()
    return (CONF,) if not own.is_dir() or own.samefile(CONF) else (CONF, own)
