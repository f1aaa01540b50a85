"""The public sets that are read: what they are called, and who finds and reads their recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mocap.errors import MocapError
from mocap.io.sets import biocv, human36m, humaneva, mpi_inf_3dhp, panoptic, totalcapture
from mocap.io.sets.recording import Recording


@dataclass(frozen=True)
class PublicSet:
    """title : as its authors call it.  takes : of a folder, name of each recording -> the file that it was known by.
    read : one of them, by that file; the folder is where its other files are looked for."""

    title: str
    takes: Callable[[Path], dict[str, Path]]
    read: Callable[[Path, Path], Recording]


SETS: dict[str, PublicSet] = {
    "biocv": PublicSet("bioCV", biocv.takes, biocv.read),
    "human36m": PublicSet("Human3.6M", human36m.takes, human36m.read),
    "humaneva": PublicSet("HumanEva", humaneva.takes, humaneva.read),
    "mpi-inf-3dhp": PublicSet("MPI-INF-3DHP", mpi_inf_3dhp.takes, mpi_inf_3dhp.read),
    "panoptic": PublicSet("CMU Panoptic", panoptic.takes, panoptic.read),
    "totalcapture": PublicSet("TotalCapture", totalcapture.takes, totalcapture.read),
}


def takes_of(name: str, folder: Path) -> dict[str, Path]:
    """The recordings of a set below a folder; MocapError where there is none."""
    if not folder.is_dir():
        raise MocapError("no such folder", path=folder, remedy="check the path")
    found = SETS[name].takes(folder)
    if not found:
        raise MocapError(
            f"the folder holds no recording of {SETS[name].title}",
            path=folder,
            remedy="see docs/public-sets.md for what must lie where",
        )
    return found
