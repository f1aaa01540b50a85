"""Figures of the report: plots of errors, paths, time, silhouettes and the filter."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import LANDMARKS
from mocap.io.tables import read_landmarks_csv, read_tracks_csv
from mocap.metrics import point_errors
from mocap.pipeline.panels import chosen_frames, images_of
from mocap.pipeline.record import OUTPUTS, Found, RunRecord
from mocap.pipeline.scene_frames import room_bounds
from mocap.products import hulls as hulls_product
from mocap.products import masks as masks_product
from mocap.products.hulls import grid_from_attrs, hull_from_arrays
from mocap.products.masks import masks_from_arrays
from mocap.products.occluders import stored_occluders
from mocap.view import Figure
from mocap.volume import silhouette_residuals

Array = NDArray[np.float64]

SilhouetteNumbers = dict[str, dict[str, float | None]]

_RESIDUAL_FRAMES = 12  # of which hull and silhouettes are compared


def run_figures(record: RunRecord, found: Found, silhouettes: SilhouetteNumbers) -> Iterator[Figure]:
    """Every figure that there is something to draw for.  silhouettes : of `silhouette_numbers`."""
    yield from _accuracy(record, found)
    yield _paths(found)
    yield from _timing(record)
    yield from _silhouettes(found, silhouettes)
    yield from _occluders(found)
    yield from _filter_health(found)


def _accuracy(record: RunRecord, found: Found) -> Iterator[Figure]:
    from mocap.view import plot_error_over_time, plot_landmark_errors

    truth = found.session.truth_dir
    if record.scores is None or truth is None or not found.poses:
        return
    errors = errors_by_person(found, truth)
    if errors:
        yield Figure(
            "Error over time",
            "Distance between estimated and true landmarks: mean and worst landmark of every frame.",
            plot_error_over_time(errors),
            section="accuracy",
        )
    per_landmark = record.scores.get("per_landmark_mm")
    if per_landmark:
        yield Figure(
            "Error by landmark",
            "Mean distance to the truth. Definitions of neck, head and hips differ between body models by "
            "a few centimetres.",
            plot_landmark_errors({k: v for k, v in per_landmark.items() if v is not None}),
            section="accuracy",
        )


def _paths(found: Found) -> Figure:
    from mocap.view import plot_track_map

    truth, true_tracks = found.session.truth_dir, None
    if truth is not None and (truth / "tracks.csv").exists():
        true_tracks = read_tracks_csv(truth / "tracks.csv")
    return Figure(
        "Paths from above",
        "Cameras, room and the path of every person; truth dashed where it is known.",
        plot_track_map(found.session.rig, found.tracks, true_tracks, bounds_m=room_bounds(found)),
        section="tracks",
    )


def _timing(record: RunRecord) -> Iterator[Figure]:
    from mocap.view import plot_stage_timing

    timing = {k: 1000.0 * v / len(record.frames) for k, v in record.timings_s.items() if k != OUTPUTS}
    if timing:
        yield Figure(
            "Time per stage",
            "Wall-clock milliseconds per frame.",
            plot_stage_timing(timing),
            section="timing",
        )


def _silhouettes(found: Found, silhouettes: SilhouetteNumbers) -> Iterator[Figure]:
    from mocap.view import plot_foreground_share, plot_mask_quality

    if found.hulls is not None:
        rows = [(frame, a["share"]) for frame, a in found.hulls.reader(masks_product.PRODUCT)]
        shares = np.array([share for _, share in rows], dtype=np.float64)
        yield Figure(
            "Foreground by camera",
            "Share of the picture that was taken for a person; a jump in one camera is a light or a bump.",
            plot_foreground_share(
                np.array([frame for frame, _ in rows]),
                {name: shares[:, c] for c, name in enumerate(found.session.rig.names)},
            ),
        )
    if silhouettes:
        yield Figure(
            "Defects of the silhouettes",
            "Long bars mark cameras whose silhouettes to look at.",
            plot_mask_quality(silhouettes),
            section="silhouettes",
        )


def _occluders(found: Found) -> Iterator[Figure]:
    from mocap.view import draw_places

    if found.hulls is None:
        return
    rig = found.session.rig
    occluders = stored_occluders(found.store, rig)
    places = {c.name: occluders.standing_pixels(c) for c in rig if occluders.of(c) is not None}
    if places:
        ((_, first),) = images_of(found, found.session.frames[:1])
        pictures = dict(zip(rig.names, first, strict=True))
        yield Figure(
            "What can stand in front of people",
            "Learnt from the silhouettes: of what is behind the tinted places the camera is not asked.",
            draw_places(pictures, places),
            mime="image/jpeg",
        )


def _filter_health(found: Found) -> Iterator[Figure]:
    from mocap.view import FilterHealth, plot_filter_health

    if not found.poses or len(found.session.frames) < 2:
        return
    health = [
        FilterHealth(person=p.person, frames=p.frames, ess_share=p.ess_share, log_likelihood=p.log_likelihood)
        for p in found.poses
    ]
    yield Figure(
        "Health of the filter",
        "Effective share of the particles and log-likelihood of the pose; a drop marks frames to look at.",
        plot_filter_health(health),
    )


def silhouette_numbers(record: RunRecord, found: Found) -> SilhouetteNumbers:
    """The quality of each camera's masks, with the share that the hull of some frames does not reach."""
    numbers = {name: dict(row) for name, row in record.numbers.get("segment", {}).get("cameras", {}).items()}
    if not numbers or found.hulls is None:
        return numbers
    hulls, masks = found.store.reader(hulls_product.PRODUCT), found.store.reader(masks_product.PRODUCT)
    grid = grid_from_attrs(hulls.attrs)
    uncovered = []
    for frame in chosen_frames(found, hulls.frames, _RESIDUAL_FRAMES):
        hull = hull_from_arrays(grid, hulls.read(int(frame)))
        silhouettes = masks_from_arrays(masks.read(int(frame)), found.session)
        if len(hull):
            uncovered.append(silhouette_residuals(hull, silhouettes, found.session.rig).uncovered)
    for c, name in enumerate(found.session.rig.names):
        known = [float(row[c]) for row in uncovered if np.isfinite(row[c])]
        numbers[name]["residual"] = float(np.median(known)) if known else None
    return numbers


def errors_by_person(found: Found, truth_dir: Path) -> dict[int, tuple[NDArray[np.int64], Array]]:
    """Frames (T,) and landmark errors (T, 15) mm of every estimated person that the truth knows."""
    from mocap.compare import associate_persons

    truth = read_landmarks_csv(truth_dir / "landmarks.csv")
    errors = {}
    for estimate, true in associate_persons(found.motions, truth, frames=list(found.session.frames)):
        if estimate is None or true is None:
            continue
        common, i, j = np.intersect1d(estimate.frames, true.frames, return_indices=True)
        if len(common):
            scored = slice(None, len(LANDMARKS))
            mm = point_errors(estimate.landmarks[i][:, scored], true.landmarks[j][:, scored])
            errors[estimate.person] = (common, mm)
    return errors
