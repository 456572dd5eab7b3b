"""Importers of other people's recordings, one file a format: every value is checked, and errors name file and row."""

from tossid.store.importers.contactnets import ContactNetsSource, read_contactnets
from tossid.store.importers.pll import PllSource, read_pll
from tossid.store.importers.registry import Imported, register_importer
from tossid.store.importers.tum import TumSource, read_tum, write_tum

__all__ = [
    "ContactNetsSource",
    "Imported",
    "PllSource",
    "TumSource",
    "read_contactnets",
    "read_pll",
    "read_tum",
    "register_importer",
    "write_tum",
]
