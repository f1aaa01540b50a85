"""Silhouettes of one camera after the other, as whoever looks at cameras and not at people needs them.

They come from each camera's own pictures alone: neither calibration nor other cameras have a say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from mocap.arrays import Array, Image, Mask
from mocap.data import Camera
from mocap.foreground import Fit, Segmenter, median_background
from mocap.io.session import Session
from mocap.io.session.reading import masks_of, pictures_of
from mocap.progress import Progress, no_progress
from mocap.threads import in_parallel
from mocap.volume.synchrony import silhouette_hull


def foreground(pictures: Callable[[], Iterable[Image]], empty: Fit | None) -> Iterator[Mask]:
    """The foreground (H, W) of one camera's pictures.

    pictures : begins them anew at every call.  empty : of the clip of the empty scene; the median of the pictures takes
    its place where there is none, or one of another place.
    """
    if empty is None or empty.is_elsewhere:
        background = median_background(pictures())
    else:
        background = empty.background
    segmenter = Segmenter(background)
    for picture in pictures():
        yield segmenter.segment(picture).mask


def hulls_of(
    session: Session,
    frames: range,
    fits: Mapping[str, Fit],
    *,
    n_threads: int = 1,
    progress: Progress = no_progress,
) -> list[list[Array]]:
    """Corners (P, 2) px of the convex hull of the silhouettes, per camera of the session and frame.

    fits : of the cameras that have a clip of the empty scene, as `fits_of` gives them.
    """
    done = iter(range(len(session.rig)))

    def of_camera(camera: Camera) -> list[Array]:
        hulls = [silhouette_hull(mask) for mask in _masks(session, camera, frames, fits)]
        progress("silhouettes", next(done) + 1, len(session.rig))
        return hulls

    return in_parallel(of_camera, session.rig.cameras, n_threads)


def _masks(session: Session, camera: Camera, frames: range, fits: Mapping[str, Fit]) -> Iterator[Mask]:
    """Of one camera in some frames of the session."""
    if session.mask_sources:
        with masks_of(session, frames, cameras=(camera.name,)) as reader:
            yield from (masks[0] for _, masks in reader)
        return

    def pictures() -> Iterator[Image]:
        with pictures_of(session, frames, cameras=(camera.name,)) as reader:
            yield from (images[0] for _, images in reader)

    yield from foreground(pictures, fits.get(camera.name))
