"""TRC, the marker table of OpenSim and Pose2Sim."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap.data import LANDMARKS, Motion
from mocap.io.export._common import Y_UP_FROM_WORLD, check_fps, gap_free, write_bytes


def write_trc(path: Path, motion: Motion, fps: float) -> None:
    """Write the landmarks of one person as a TRC file in metres, Y up.

    The axes are those of Pose2Sim and OpenSim: file (x, y, z) = scene (y, z, x), so a reader gets the scene
    back as file (z, x, y). One row for every frame from the motion's first to its last, `Frame#` counts from
    0 as everywhere here; an unknown landmark is three blank cells. A motion without frames gives a header
    only. Raises ValueError for fps <= 0, MocapError when the file cannot be written.
    """
    check_fps(fps)
    path = Path(path)
    motion = gap_free(motion, fps)
    n_markers = len(LANDMARKS)
    first = int(motion.frames[0]) if len(motion) else 0
    header = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"]
    header += ["OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]
    rate = f"{fps:g}"
    values = [rate, rate, str(len(motion)), str(n_markers), "m", rate, str(first), str(len(motion))]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "\t".join(header),
        "\t".join(values),
        "Frame#\tTime\t" + "\t\t\t".join(LANDMARKS) + "\t\t",
        "\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, n_markers + 1)),
    ]
    points = motion.landmarks @ Y_UP_FROM_WORLD.T
    for frame, time_s, row in zip(motion.frames, motion.time_s, points, strict=True):
        cells = [
            "\t\t" if not np.isfinite(point).all() else "\t".join(f"{value:.6f}" for value in point)
            for point in row
        ]
        lines.append(f"{int(frame)}\t{time_s:.6f}\t" + "\t".join(cells))
    write_bytes(path, ("\n".join(lines) + "\n").encode("utf-8"))
