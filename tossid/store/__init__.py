"""The store: toss datasets in HDF5, and importers of other people's recordings. Only this room opens HDF5.

Every name below is imported when it is first used: the command line reads the importers' settings, which lie in this
room, for its help pages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tossid.first_use import imported_at_first_use

if TYPE_CHECKING:
    from tossid.store.dataset import Dataset, write_dataset
    from tossid.store.hashing import file_sha256, source_sha256
    from tossid.store.importers.contactnets import read_contactnets
    from tossid.store.importers.pll import read_pll
    from tossid.store.importers.tum import read_tum, write_tum
    from tossid.store.reading import dataset_info, open_dataset, read_dataset
    from tossid.store.schema import KNOWN_SCHEMAS, SCHEMA
    from tossid.store.splits import draw_splits, drawn_splits
    from tossid.store.writing import dataset_writer
else:
    __all__, __getattr__, __dir__ = imported_at_first_use(__name__)
