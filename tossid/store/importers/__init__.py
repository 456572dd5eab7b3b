"""Importers of other people's recordings: every file is checked, and an error names the file and the row."""

from tossid.store.importers.contactnets import read_contactnets
from tossid.store.importers.pll import read_pll
from tossid.store.importers.tum import read_tum, write_tum

__all__ = ["read_contactnets", "read_pll", "read_tum", "write_tum"]
