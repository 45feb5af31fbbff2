"""Reading tables of numbers from files of any format."""

from bayesfric.recordings.tables.reader import is_recording, read_table, sha256
from bayesfric.recordings.tables.table import Table

__all__ = ["Table", "is_recording", "read_table", "sha256"]
