"""Make the picture of docs/tracking.md from a synthetic crossing of two persons.

mocap synth --scene crossing_01 -o out/crossing/session
mocap carve out/crossing/session -o out/crossing/result --frames 0:110
python -m docs.make_tracking_picture out/crossing/result
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import Hull
from mocap.io.store import StageStore
from mocap.pipeline.tracking import tracker_input
from mocap.products.hulls import hull_from_arrays, stored_grid
from mocap.tracking import TrackerSettings, TrackerState, TrackInfo, track_step

PICTURE = Path(__file__).with_name("pictures") / "trackers.png"
MAX_BYTES = 150_000
TRACKERS = {"naive": "naive: ellipsoids", "particle": "particles", "sparse": "sparse samples"}
COLOURS = {1: "#0072b2", 2: "#d55e00", 3: "#009e73"}
FPS = 15.0


def followed(hulls: list[tuple[int, Hull]], tracker: str) -> list[TrackInfo]:
    """What a tracker says of every frame."""
    grid = hulls[0][1].grid
    settings = TrackerSettings(
        grid.voxel_size_m, tracker=tracker, fps=FPS, n_samples=150 if tracker == "sparse" else None
    )
    rng = np.random.default_rng(0)
    state, infos = TrackerState(), []
    for frame, hull in hulls:
        state, info = track_step(state, tracker_input(frame, hull).voxels, settings, rng=rng)
        infos.append(info)
    return infos


def closest(infos: list[TrackInfo]) -> int:
    """Index of the frame in which two persons are nearest to one another."""
    gaps = [
        np.linalg.norm(i.tracks[0].xyz[:2] - i.tracks[1].xyz[:2]) if len(i.tracks) > 1 else np.inf
        for i in infos
    ]
    return int(np.argmin(gaps))


def draw(hulls: list[tuple[int, Hull]]) -> bytes:
    """Seen from above: the hull in its own colours with the paths, and owners and samples of each tracker."""
    import matplotlib.pyplot as plt
    from matplotlib.patches import Circle

    found = {tracker: followed(hulls, tracker) for tracker in TRACKERS}
    n = closest(found["naive"])
    hull = hulls[n][1]
    middle = hull.centers[:, :2].mean(axis=0)
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.9), constrained_layout=True, sharex=True, sharey=True)
    seen = np.flatnonzero(hull.n_views > 0)
    seen = seen[np.argsort(hull.centers[seen, 2], kind="stable")]
    axes[0].scatter(*hull.centers[seen, :2].T, c=hull.rgb[seen] / 255.0, s=7, marker="s", lw=0)
    for person in (1, 2):
        path = np.array([t.xyz[:2] for i in found["naive"] for t in i.tracks if t.person == person])
        axes[0].plot(*path.T, color=COLOURS[person], lw=1.2)
        axes[0].plot(*path[0], "o", color=COLOURS[person], ms=5)
    axes[0].set_title(f"hull and paths, frame {hulls[n][0]}")
    for ax, (tracker, words) in zip(axes[1:], TRACKERS.items(), strict=True):
        info = found[tracker][n]
        for track in info.tracks:
            own = hull.centers[info.voxels_of[track.person], :2]
            colour = COLOURS.get(track.person, "#777777")
            ax.plot(*own.T, "s", color=colour, ms=1.6, mew=0, alpha=0.25)
            if len(track.samples):
                ax.plot(*track.samples[:, :2].T, ".", color="black", ms=2.2)
            else:
                ax.add_patch(Circle(tuple(track.xyz[:2]), 0.45, fill=False, color="black", lw=0.8))
            ax.plot(*track.xyz[:2], "P", color="white", mec="black", ms=8)
        ax.set_title(words)
    for ax in axes:
        ax.set_aspect("equal")
        ax.set_xlim(middle[0] - 0.8, middle[0] + 0.8)
        ax.set_ylim(middle[1] - 0.8, middle[1] + 0.8)
        ax.set_xlabel("x (m)")
    axes[0].set_ylabel("y (m)")
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=80)
    plt.close(figure)
    return out.getvalue()


def hulls_of(run: Path) -> list[tuple[int, Hull]]:
    """All hulls of a run."""
    store = StageStore(run / "store.zarr")
    grid = stored_grid(store)
    return [(frame, hull_from_arrays(grid, arrays)) for frame, arrays in store.reader("carve")]


def quantised(png: bytes) -> bytes:
    """The same picture with 256 colours, which is a third of the size."""
    import cv2

    image = cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    coarse: NDArray[np.uint8] = (image // 8 * 8 + 4).astype(np.uint8)
    coarse[image > 250] = 255
    ok, data = cv2.imencode(".png", coarse, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert ok
    return bytes(data)


def main() -> int:
    """Make the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path, help="output folder of `mocap carve`")
    chosen = parser.parse_args()
    data = draw(hulls_of(chosen.run))
    data = data if len(data) <= MAX_BYTES else quantised(data)
    if len(data) > MAX_BYTES:
        sys.exit(f"the picture has {len(data)} bytes, at most {MAX_BYTES} are wanted")
    PICTURE.write_bytes(data)
    print(f"{PICTURE}: {len(data) / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
