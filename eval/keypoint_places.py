"""Where a tool's keypoints lie on bodies whose joints are known, and how far they stray.

    python -m eval.keypoint_places      # MediaPipe's detections, on `steps` and `furnished`

A body is fitted to the true landmarks of a session; the points on which the cameras agree are then read in the frames
of its joints. The medians are the places of `mocap/body/keypoints.py`, the errors by confidence the deviation of
`mocap/tracking/figures.py`.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body, landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.keypoints import PLACES, place_keypoints
from mocap.body.kinematics import joint_transforms
from mocap.body.markers import Markers
from mocap.data import LANDMARKS, CameraRig
from mocap.data.keypoints import KEYPOINTS
from mocap.filters.refine import RefineSettings, refine
from mocap.io.calibration import read_calibration
from mocap.io.keypoints import read_keypoints
from mocap.io.tables import read_landmarks_csv
from mocap.likelihood.keypoints import KeypointProblem, KeypointSettings, KeypointViews
from mocap.likelihood.markers import BundleSettings, bundle, marker_views
from mocap.pipeline.stages.keypoints import figure_views, undistorted
from mocap.tracking.figures import FigureSettings, persons_of_figures

Array = NDArray[np.float64]
DEV = Path(__file__).resolve().parents[2] / "shared" / "dev_sessions"
FITTED_ON = ("steps", "furnished")  # of which no result is reported with keypoints
_USUAL_HEIGHT_M = 1.72
_N_FIT = 30
_BINS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.01)


def main() -> None:
    """Print the mean place of every kind of keypoint, fractions of the height, and the errors by confidence."""
    places: dict[str, list[Array]] = {}
    errors: list[tuple[float, float]] = []
    for name in FITTED_ON:
        rig = read_calibration(DEV / name / "calibration.toml").rig
        truth = read_landmarks_csv(DEV / name / "truth" / "landmarks.csv")[0]
        body, states = body_of_landmarks(rig, truth.landmarks)
        left = np.linalg.norm(landmarks_of(body, states) - truth.landmarks, axis=2)
        print(f"{name}: the body is fitted to {1000 * left.mean():.1f} mm")
        for kind, place in _places(name, rig, body, states, truth.frames).items():
            places.setdefault(kind, []).append(place)
        errors += _errors_m(name, rig, truth.landmarks, truth.frames)
    for kind, found in places.items():
        print(f"{kind:10s}", np.mean(found, axis=0).round(3))
    table = np.array(errors)
    for low, high in pairwise(_BINS):
        own = table[(table[:, 0] >= low) & (table[:, 0] < high), 1]
        if len(own):
            print(
                f"confidence {low:.2f} to {high:.2f}: {len(own)} points, median {1000 * np.median(own):.0f} mm"
            )


def body_of_landmarks(rig: CameraRig, landmarks: Array) -> tuple[Body, Array]:
    """The body, and its states (T, D), that come nearest to landmarks (T, 15, 3) m."""
    P = marker_views(rig).P
    settings = KeypointSettings(scale=1e3)
    refining = RefineSettings(np.full(len(neutral_state(_usual())), 10.0), 1.0, 15)
    body = _usual()

    def problem(of: Body, markers: Markers, x: Array) -> KeypointProblem:
        uvw = np.einsum("crk,nk->cnr", P, np.column_stack([x, np.ones(len(x))]))
        uv = uvw[..., :2] / uvw[..., 2:]
        return KeypointProblem(of, markers, KeypointViews(P, uv, np.full(uv.shape[:2], 2.0)), settings)

    def followed(of: Body, markers: Markers, start: Array) -> Array:
        states = [start]
        for x in landmarks:
            state = states[-1]
            for _ in range(10 if len(states) == 1 else 3):
                state, _ = refine(problem(of, markers, x), state, refining)
            states.append(state)
        return np.array(states[1:])

    start = neutral_state(body)
    across = landmarks[0, LANDMARKS.index("left_hip")] - landmarks[0, LANDMARKS.index("right_hip")]
    start[:3], start[body.yaw_column] = landmarks[0, 0], np.arctan2(-across[0], across[1])
    markers = _at_landmarks(body)
    states = followed(body, markers, start)
    rows = np.linspace(0, len(landmarks) - 1, _N_FIT).astype(int)
    free = BundleSettings(offset_std_m=1e-4, size_std=0.2, stretch_std=0.1)
    fit = bundle([problem(body, markers, landmarks[r]) for r in rows], states[rows], free)
    return fit.body, followed(fit.body, _at_landmarks(fit.body), states[0])


def _usual() -> Body:
    return scale_body(load_body_model("girdle"), _USUAL_HEIGHT_M)


def _at_landmarks(body: Body) -> Markers:
    n = len(LANDMARKS)
    return Markers(LANDMARKS, body.landmark_joint, body.landmark_parts, body.landmark_offset, np.zeros(n))


def _places(
    name: str, rig: CameraRig, body: Body, states: Array, frames: NDArray[np.int64]
) -> dict[str, Array]:
    """Kind of keypoint -> its mean place beside its landmark, mirrored to the left side, fractions of the height."""
    views = figure_views(marker_views(rig))
    read = read_keypoints(files_of(name, rig), rig, range(int(frames[-1]) + 1))
    figures = {int(f): undistorted(read[int(f)], rig) for f in frames}
    person = persons_of_figures(figures, views, 30.0, FigureSettings())[0]
    row = {int(f): i for i, f in enumerate(frames)}
    R, t = joint_transforms(body, states)
    sits = place_keypoints(body)
    found: dict[str, list[Array]] = {}
    for k, keypoint in enumerate(KEYPOINTS):
        side, _, kind = keypoint.rpartition("_")
        joint = sits.joint[k]
        own = [(row[f], person.points[f][k]) for f in person.frames if np.isfinite(person.points[f][k]).all()]
        if not own:
            continue
        local = np.median([R[i, joint].T @ (x - t[i, joint]) for i, x in own], axis=0)
        mirror = np.array([1.0, -1.0 if side == "right" else 1.0, 1.0])
        place = PLACES[kind].offset + mirror * (local - sits.offset[k]) / body.height_m
        found.setdefault(kind, []).append(place)
    return {kind: np.mean(of_sides, axis=0) for kind, of_sides in found.items()}


def files_of(name: str, rig: CameraRig) -> dict[str, Path]:
    """Keypoint files of a development session by camera."""
    return {camera.name: DEV / "keypoints" / name / f"{camera.name}.csv" for camera in rig}


def _errors_m(
    name: str, rig: CameraRig, landmarks: Array, frames: NDArray[np.int64]
) -> list[tuple[float, float]]:
    """Confidence and distance, m at the person, of every keypoint that has a true landmark of its name."""
    read = read_keypoints(files_of(name, rig), rig, range(int(frames[-1]) + 1))
    shared = [(KEYPOINTS.index(n), i) for i, n in enumerate(LANDMARKS) if n in KEYPOINTS and "_" in n]
    out = []
    for i, frame in enumerate(frames):
        figures = read[int(frame)]
        for n, c in enumerate(figures.camera):
            camera = rig[int(c)]
            uv, depth = camera.project(landmarks[i])
            for k, j in shared:
                error = np.linalg.norm(figures.uv[n, k] - uv[j]) * depth[j] / camera.K[0, 0]
                if np.isfinite(error):
                    out.append((float(figures.confidence[n, k]), float(error)))
    return out


if __name__ == "__main__":
    main()
