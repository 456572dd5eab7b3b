"""The store: toss datasets in HDF5, and importers of other people's recordings. Only this room opens HDF5.

Every name below is imported when it is first used: the command line reads the importers' settings, which lie in this
room, for its help pages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tossid.first_use import imported_at_first_use

if TYPE_CHECKING:
    from tossid.store.dataset import Dataset as Dataset
    from tossid.store.dataset import write_dataset as write_dataset
    from tossid.store.hashing import file_sha256 as file_sha256
    from tossid.store.hashing import source_sha256 as source_sha256
    from tossid.store.importers.contactnets import read_contactnets as read_contactnets
    from tossid.store.importers.pll import read_pll as read_pll
    from tossid.store.importers.tum import read_tum as read_tum
    from tossid.store.importers.tum import write_tum as write_tum
    from tossid.store.reading import dataset_info as dataset_info
    from tossid.store.reading import open_dataset as open_dataset
    from tossid.store.reading import read_dataset as read_dataset
    from tossid.store.schema import KNOWN_SCHEMAS as KNOWN_SCHEMAS
    from tossid.store.schema import SCHEMA as SCHEMA
    from tossid.store.splits import draw_splits as draw_splits
    from tossid.store.splits import drawn_splits as drawn_splits
    from tossid.store.writing import dataset_writer as dataset_writer

_HOMES = {
    "Dataset": "tossid.store.dataset",
    "file_sha256": "tossid.store.hashing",
    "source_sha256": "tossid.store.hashing",
    "read_contactnets": "tossid.store.importers.contactnets",
    "read_pll": "tossid.store.importers.pll",
    "read_tum": "tossid.store.importers.tum",
    "write_tum": "tossid.store.importers.tum",
    "dataset_info": "tossid.store.reading",
    "open_dataset": "tossid.store.reading",
    "read_dataset": "tossid.store.reading",
    "KNOWN_SCHEMAS": "tossid.store.schema",
    "SCHEMA": "tossid.store.schema",
    "draw_splits": "tossid.store.splits",
    "drawn_splits": "tossid.store.splits",
    "dataset_writer": "tossid.store.writing",
    "write_dataset": "tossid.store.dataset",
}
"""The public names, and the module that defines each."""

__all__ = [*_HOMES]

if not TYPE_CHECKING:
    __getattr__ = imported_at_first_use(__name__, _HOMES)
