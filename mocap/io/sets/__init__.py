"""Public sets of recordings with a measured truth: one module per set, one that writes a recording as a session."""

from mocap.io.sets.recording import Recording
from mocap.io.sets.table import SETS, takes_of
from mocap.io.sets.writing import Imported, imported, write_session

__all__ = ["SETS", "Imported", "Recording", "imported", "takes_of", "write_session"]
