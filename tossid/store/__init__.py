"""The store: toss datasets in HDF5, and importers of other people's recordings. Only this room opens HDF5."""

from tossid.store.dataset import Dataset
from tossid.store.hashing import file_sha256, source_sha256
from tossid.store.importers import read_contactnets, read_pll, read_tum, write_tum
from tossid.store.reading import dataset_info, open_dataset, read_dataset
from tossid.store.schema import KNOWN_SCHEMAS, SCHEMA
from tossid.store.splits import draw_splits, drawn_splits
from tossid.store.writing import dataset_writer, write_dataset

__all__ = [
    "Dataset",
    "KNOWN_SCHEMAS",
    "SCHEMA",
    "dataset_info",
    "dataset_writer",
    "draw_splits",
    "drawn_splits",
    "file_sha256",
    "open_dataset",
    "read_contactnets",
    "read_dataset",
    "read_pll",
    "read_tum",
    "source_sha256",
    "write_dataset",
    "write_tum",
]
