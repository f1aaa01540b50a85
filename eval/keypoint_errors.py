"""How a pose network errs, by kind of keypoint: the numbers of `mocap.synth.keypoints`.

    python -m eval.keypoint_errors      # on `steps` and `furnished`, MediaPipe's detections

Errors are those in one picture, in metres at the person's distance. Of each kind: a constant place in the frame of the
trunk (`bias_m`), the deviation and correlation from frame to frame of what is left, the share of points further off
than four deviations and how far they are; of whole figures the share whose left and right are exchanged.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from eval.keypoint_places import DEV, FITTED_ON, files_of
from mocap.data import LANDMARKS
from mocap.data.keypoints import KEYPOINTS
from mocap.io.calibration import read_calibration
from mocap.io.keypoints import read_keypoints
from mocap.io.tables import read_landmarks_csv
from mocap.synth.keypoints import KINDS, trunk_frame

Array = NDArray[np.float64]

_FAR_STDS = 4.0
_MIRROR = np.array([1.0, -1.0, 1.0])
# Of one kind: clip of one side, frame, error (2,) m, axes (2, 3) of the trunk as the camera sees it, mirrored left.
_Sample = tuple[int, int, Array, Array]


def main() -> None:
    """Print the table."""
    samples: dict[str, list[_Sample]] = {kind: [] for kind in KINDS}
    n_figures = n_exchanged = 0
    for number, name in enumerate(FITTED_ON):
        seen, exchanged = _collect(name, 100 * number, samples)
        n_figures, n_exchanged = n_figures + seen, n_exchanged + exchanged
    print(f"exchanged sides: {n_exchanged} of {n_figures} figures")
    for kind, found in samples.items():
        own = sorted(found, key=lambda s: s[:2])
        error, axes = np.array([s[2] for s in own]), np.array([s[3] for s in own])
        bias = _robust_bias(error, axes)
        left = error - axes @ bias
        std = 1.4826 * np.median(np.abs(left))
        far = np.abs(left).max(axis=1) > _FAR_STDS * std
        follows = [
            (a, a + 1)
            for a in range(len(own) - 1)
            if own[a][0] == own[a + 1][0] and own[a][1] + 1 == own[a + 1][1] and not far[a : a + 2].any()
        ]
        pairs = np.array([[left[a].ravel(), left[b].ravel()] for a, b in follows])
        correlation = float((pairs[:, 0] * pairs[:, 1]).mean() / (pairs**2).mean())
        print(
            f"{kind:9s} bias {bias.round(3)} std {std:.3f} correlation {correlation:.2f} "
            f"far {far.mean():.3f} by {np.sqrt((left[far] ** 2).mean()):.2f} m"
        )


def _collect(name: str, first: int, samples: dict[str, list[_Sample]]) -> tuple[int, int]:
    """Add the errors of a session; how many figures it has, and of how many left and right are exchanged."""
    rig = read_calibration(DEV / name / "calibration.toml").rig
    truth = read_landmarks_csv(DEV / name / "truth" / "landmarks.csv")[0]
    read = read_keypoints(files_of(name, rig), rig, range(int(truth.frames[-1]) + 1))
    rows = {s: [KEYPOINTS.index(f"{s}_{kind}") for kind in KINDS] for s in ("left", "right")}
    marks = {s: [LANDMARKS.index(f"{s}_{kind}") for kind in KINDS] for s in ("left", "right")}
    n = n_exchanged = 0
    for landmarks, frame in zip(truth.landmarks, truth.frames, strict=True):
        figures, R = read[int(frame)], trunk_frame(landmarks)
        for i, c in enumerate(figures.camera):
            camera = rig[int(c)]
            uv, depth = camera.project(landmarks)
            scale = depth / camera.K[0, 0]
            sides = {"left": "left", "right": "right"}
            straight, crossed = (
                np.nanmedian(
                    [np.linalg.norm(figures.uv[i, rows[s]] - uv[marks[t]], axis=1) for s, t in pairs]
                )
                for pairs in (sides.items(), (("left", "right"), ("right", "left")))
            )
            n += 1
            if crossed < 0.5 * straight:
                n_exchanged += 1
                continue
            for side, mirror in (("left", np.ones(3)), ("right", _MIRROR)):
                for kind, k, j in zip(KINDS, rows[side], marks[side], strict=True):
                    error = (figures.uv[i, k] - uv[j]) * scale[j]
                    if np.isfinite(error).all():
                        axes = camera.R[:2] @ R * mirror
                        samples[kind].append(
                            (first + 2 * int(c) + (side == "right"), int(frame), error, axes)
                        )
    return n, n_exchanged


def _robust_bias(error: Array, axes: Array) -> Array:
    """The place b (3,) m with axes b = error (N, 2) for most of them."""
    keep = np.ones(len(error), dtype=np.bool_)
    for _ in range(5):
        b = np.linalg.lstsq(axes[keep].reshape(-1, 3), error[keep].ravel(), rcond=None)[0]
        left = np.linalg.norm(error - axes @ b, axis=1)
        keep = left < 3.0 * np.median(left)
    return np.asarray(b)


if __name__ == "__main__":
    main()
