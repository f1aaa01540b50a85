"""Curves and pictures of the report for researchers: errors, paths, silhouettes, furniture and the filter."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from mocap.data import LANDMARKS
from mocap.metrics import point_errors
from mocap.pipeline.pictures import chosen_frames
from mocap.pipeline.record import Found, RunRecord
from mocap.pipeline.scene_frames import room_bounds
from mocap.products import hulls as hulls_product
from mocap.products import masks as masks_product
from mocap.products.hulls import grid_from_attrs, hull_from_arrays
from mocap.products.masks import masks_from_arrays
from mocap.products.occluders import stored_occluders
from mocap.view import Figure
from mocap.view.curves import Chart, Curve, colour_of, on_every_frame
from mocap.view.html import Section
from mocap.volume import silhouette_residuals

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SilhouetteNumbers = dict[str, dict[str, float | None]]

_RESIDUAL_FRAMES = 12  # of which hull and silhouettes are compared


def run_figures(found: Found, first: Mapping[str, Image]) -> Iterator[Figure]:
    """Pictures beside the curves: the paths from above, and what can stand in front of people.

    first : camera -> picture of the first frame as filmed.
    """
    yield _paths(found)
    yield from _occluders(found, first)


def run_charts(record: RunRecord, found: Found) -> Iterator[tuple[Section, Chart]]:
    """Curves over time that researchers look at, each with the section of the report that it belongs to."""
    yield from (("accuracy", chart) for chart in _errors(record, found))
    yield from (("silhouettes", chart) for chart in _foreground(found))
    yield from (("other", chart) for chart in _filter_health(found))


def _errors(record: RunRecord, found: Found) -> Iterator[Chart]:
    if record.scores is None or not found.poses:
        return
    for person, (frames, errors) in errors_by_person(found).items():
        with np.errstate(invalid="ignore"):
            known = np.isfinite(errors).any(axis=1)
        frames, errors = frames[known], errors[known]
        if len(frames):
            curves = (
                Curve("mean", "middle", np.nanmean(errors, axis=1)),
                Curve("worst landmark", "right", np.nanmax(errors, axis=1)),
            )
            yield on_every_frame(
                Chart(f"Error over time, person {person}", "mm", frames, found.session.fps, curves)
            )


def _paths(found: Found) -> Figure:
    from mocap.view import track_map_svg

    return Figure(
        "Paths from above",
        "Cameras, room and the path of every person; truth dashed where it is known.",
        track_map_svg(
            found.session.rig, found.tracks, found.session.true_tracks, bounds_m=room_bounds(found)
        ),
        mime="image/svg+xml",
        section="tracks",
    )


def _foreground(found: Found) -> Iterator[Chart]:
    """The share of every picture that was taken for a person; a jump in one camera is a light or a bump."""
    if found.hulls is None:
        return
    masks = found.hulls.reader(masks_product.PRODUCT)
    rows = [(frame, a["share"]) for frame, a in masks.rows("share")]
    if not rows:
        return
    shares = 100.0 * np.array([share for _, share in rows], dtype=np.float64)
    curves = tuple(Curve(name, colour_of(c), shares[:, c]) for c, name in enumerate(found.session.rig.names))
    frames = np.array([frame for frame, _ in rows], dtype=np.int64)
    yield on_every_frame(Chart("Foreground by camera", "% of the picture", frames, found.session.fps, curves))


def _occluders(found: Found, first: Mapping[str, Image]) -> Iterator[Figure]:
    from mocap.view import draw_places

    if found.hulls is None:
        return
    rig = found.session.rig
    occluders = stored_occluders(found.store, rig)
    places = {c.name: occluders.standing_pixels(c) for c in rig if occluders.of(c) is not None}
    if places:
        yield Figure(
            "What can stand in front of people",
            "Learnt from the silhouettes: of what is behind the tinted places the camera is not asked.",
            draw_places(first, places),
            mime="image/jpeg",
        )


def _filter_health(found: Found) -> Iterator[Chart]:
    """Effective share of the particles and log-likelihood of the pose; a drop marks frames to look at."""
    if len(found.session.frames) < 2:
        return
    for p in found.poses:
        for title, unit, values in (
            ("Particles that carry weight", "share", p.ess_share),
            ("Log-likelihood of the pose", "nats", p.log_likelihood),
        ):
            if np.isfinite(values).any():
                curve = Curve(f"person {p.person}", "middle", np.where(np.isfinite(values), values, np.nan))
                name = f"{title}, person {p.person}"
                yield on_every_frame(Chart(name, unit, p.frames, found.session.fps, (curve,)))


def silhouette_numbers(record: RunRecord, found: Found) -> SilhouetteNumbers:
    """The quality of each camera's masks, with the share that the hull of some frames does not reach."""
    numbers = {name: dict(row) for name, row in record.numbers.get("segment", {}).get("cameras", {}).items()}
    if not numbers or found.hulls is None:
        return numbers
    hulls, masks = found.store.reader(hulls_product.PRODUCT), found.store.reader(masks_product.PRODUCT)
    grid = grid_from_attrs(hulls.attrs)
    uncovered = []
    for frame in chosen_frames(found, _RESIDUAL_FRAMES):
        hull = hull_from_arrays(grid, hulls.read(frame))
        silhouettes = masks_from_arrays(masks.read(frame), found.session)
        if len(hull):
            rig = found.session.rig_at(frame)
            uncovered.append(silhouette_residuals(hull, silhouettes, rig).uncovered)
    for c, name in enumerate(found.session.rig.names):
        known = [float(row[c]) for row in uncovered if np.isfinite(row[c])]
        numbers[name]["residual"] = float(np.median(known)) if known else None
    return numbers


def errors_by_person(found: Found) -> dict[int, tuple[NDArray[np.int64], Array]]:
    """Frames (T,) and landmark errors (T, 15) mm of every estimated person that the truth knows."""
    from mocap.compare import associate_persons

    truth, errors = found.session.true_motions or [], {}
    for estimate, true in associate_persons(found.motions, truth, frames=list(found.session.frames)):
        if estimate is None or true is None:
            continue
        common, i, j = np.intersect1d(estimate.frames, true.frames, return_indices=True)
        if len(common):
            scored = slice(None, len(LANDMARKS))
            mm = point_errors(estimate.landmarks[i][:, scored], true.landmarks[j][:, scored])
            errors[estimate.person] = (common, mm)
    return errors
