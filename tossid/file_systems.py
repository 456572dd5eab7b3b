"""Which file systems are shared over a network: what SQLite and `flock` do there differs from a local disk."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

NETWORK = {
    0x6969: "NFS",
    0x517B: "SMB",
    0xFE534D42: "SMB",
    0xFF534D42: "CIFS",
    0x0BD00BD0: "Lustre",
    0x47504653: "GPFS",
    0x19830326: "BeeGFS",
    0xAAD7AAEA: "PanFS",
    0x00C36400: "Ceph",
    0x5346414F: "AFS",
    0x6B414653: "AFS",
    0x73757245: "Coda",
    0x01161970: "GFS2",
    0x7461636F: "OCFS2",
    0x01021997: "9p",
    0x786F4256: "a shared folder of VirtualBox",
    0x65735546: "FUSE",
}
"""Names of file systems that another machine may write to, by the number that `statfs` gives. FUSE may be local."""


def network_file_system(path: Path) -> str | None:
    """The network file system that a path lies on.

    Args:
        path: A file or folder. Of one that is not there yet, the nearest folder above it counts.

    Returns:
        Its name ("NFS"); None on a local file system, and where the system does not say (it is not Linux).
    """
    path = Path(os.path.abspath(path))
    while not path.exists() and path != path.parent:
        path = path.parent
    number = _type_number(path)
    return None if number is None else NETWORK.get(number)


def _type_number(path: Path) -> int | None:
    """`f_type` of Linux's statfs(2)."""
    if not sys.platform.startswith("linux"):
        return None
    content = ctypes.create_string_buffer(512)  # struct statfs, whose first member is the type, takes 120 bytes
    if ctypes.CDLL(None, use_errno=True).statfs(os.fsencode(path), content) != 0:
        return None
    return int(ctypes.c_long.from_buffer(content).value) & 0xFFFFFFFF
