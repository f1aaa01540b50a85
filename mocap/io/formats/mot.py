"""MOT, the motion file of OpenSim: generalised coordinates over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.io.formats._writing import write_bytes

Array = NDArray[np.float64]


def write_mot(
    path: Path, time_s: Array, coordinates: Mapping[str, Array], unseen: Sequence[str] = ()
) -> None:
    """Write generalised coordinates, one row per frame, in degrees and metres.

    time_s : (T,).  coordinates : name -> (T,), angles in degrees, translations in metres. OpenSim reads no gaps: NaN
    is a ValueError.  unseen : coordinates that nothing shows; the head names them as `not_observed`.
    Raises MocapError when the file cannot be written.
    """
    for name, values in coordinates.items():
        if not np.isfinite(values).all():
            raise ValueError(f"coordinate {name} is not known in every frame; OpenSim reads no gaps")
    path = Path(path)
    head = [
        path.stem,
        "version=1",
        f"nRows={len(time_s)}",
        f"nColumns={1 + len(coordinates)}",
        "inDegrees=yes",
        *([f"not_observed={' '.join(unseen)}"] if unseen else []),
        "endheader",
        "\t".join(["time", *coordinates]),
    ]
    table = np.column_stack([time_s, *coordinates.values()])
    rows = ["\t".join(f"{value:.6f}" for value in row) for row in table]
    write_bytes(path, ("\n".join([*head, *rows]) + "\n").encode("utf-8"))
