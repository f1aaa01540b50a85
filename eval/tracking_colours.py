"""Ground of the trackers' limits: likeness of colour models, and errors of centroids, on development scenes.

    python -m eval.tracking_colours

Needs the hulls of `python -m eval.tracking_scenes`. Prints, for every scene that has been made,

- likeness: Bhattacharyya coefficients of a person's colour model over the first frames in which he stands alone with
  that over his last ones, and of two persons' models; `reid_likeness` lies between the two,
- centroids: root mean square difference, along x, y and z, of the centroid of a person's own voxels from that of the
  true body, for blobs of one person and for shares of a blob; compare POSITION_STD_M in mocap/tracking/motion.py.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from eval.tracking import hulls as H
from eval.tracking.methods import observations
from mocap.tracking import TrackerSettings, TrackerState, track_step
from mocap.tracking.claims import frame_of
from mocap.tracking.colour import bhattacharyya

Array = NDArray[np.float64]
N_FRAMES = 15  # of a model
GATE_M = 0.5


def look_and_error(clip: H.HullClip) -> tuple[dict[int, list[NDArray[np.floating]]], dict[bool, list[Array]]]:
    """Histograms of every person alone, and centroid errors (3,) m by whether the blob was shared."""
    seen, _ = observations(clip)
    settings = TrackerSettings(clip.voxel_size_m, fps=clip.fps, confirm_frames=3)
    rng = np.random.default_rng(0)
    state = TrackerState()
    looks: dict[int, list[NDArray[np.floating]]] = {}
    errors: dict[bool, list[Array]] = {False: [], True: []}
    for one in seen:
        state, info = track_step(state, one, settings, rng=rng)
        frame = frame_of(one, settings)
        truth = clip.truth.xyz[clip.truth.frame == one.frame]
        for track in info.tracks:
            if track.status != "confirmed":
                continue
            voxels = info.voxels_of[track.person]
            parts = np.unique(one.labels[voxels])
            others = [v for p, v in info.voxels_of.items() if p != track.person]
            is_shared = any(np.isin(one.labels[v], parts).any() for v in others if len(v))
            if track.mixed == 0 and (look := frame.appearance(voxels)) is not None:
                looks.setdefault(track.person, []).append(look)
            if len(truth):
                gaps = track.xyz - truth
                nearest = gaps[int(np.argmin(np.linalg.norm(gaps[:, :2], axis=1)))]
                if np.linalg.norm(nearest[:2]) < GATE_M:
                    errors[is_shared].append(nearest)
    return looks, errors


def show(name: str, looks: dict[int, list[NDArray[np.floating]]], errors: dict[bool, list[Array]]) -> None:
    """Print the lines of a scene."""
    models = {
        p: (np.mean(own[:N_FRAMES], axis=0), np.mean(own[-N_FRAMES:], axis=0))
        for p, own in looks.items()
        if len(own) >= 2 * N_FRAMES
    }
    same = [bhattacharyya(a, b) for a, b in models.values()]
    other = [bhattacharyya(models[p][0], models[q][1]) for p, q in itertools.permutations(models, 2)]
    words = [f"same person {min(same):.2f} to {max(same):.2f}"] if same else []
    words += [f"two persons {min(other):.2f} to {max(other):.2f}"] if other else []
    print(f"{name:<18} likeness: {', '.join(words) or 'nobody alone for long enough'}")
    for is_shared, found in errors.items():
        if found:
            rms = 1000 * np.sqrt(np.mean(np.square(found), axis=0))
            print(
                f"{'':<18} {'shared' if is_shared else 'alone':<7} {len(found):>5} centroids, rms mm {np.round(rms, 1)}"
            )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--voxel-cm", type=int, default=2, choices=H.VOXEL_CM)
    chosen = parser.parse_args(arguments)
    every: dict[bool, list[Array]] = {False: [], True: []}
    for name in H.DEVELOPMENT:
        if not H.is_made(name, (chosen.voxel_cm,)):
            print(f"{name} has not been made and is left out")
            continue
        looks, errors = look_and_error(H.load_hulls(name, chosen.voxel_cm))
        show(name, looks, errors)
        for is_shared, found in errors.items():
            every[is_shared] += found
    show("all scenes", {}, every)
    return 0


if __name__ == "__main__":
    sys.exit(main())
