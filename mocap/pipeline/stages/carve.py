"""Carving: from masks to coloured hulls in the store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, Hull, Occluders, VoxelGrid
from mocap.data.depth import DepthNoise
from mocap.data.keypoints import NOBODY
from mocap.data.voxels import Voxels
from mocap.errors import MocapError
from mocap.foreground.pixels import sample_silhouettes
from mocap.io.session import Session
from mocap.io.session.reading import depth_of, pictures_of
from mocap.io.store import StageReader
from mocap.pipeline.config import Config, VolumeConfig
from mocap.pipeline.stage import (
    Ending,
    FrameWork,
    Job,
    Row,
    Seen,
    Sources,
    Stage,
    StageReport,
)
from mocap.products.hulls import PRODUCT, hull_attrs, hull_row, stored_faults, stored_grid
from mocap.products.masks import never_empty, read_masks
from mocap.products.occluders import stored_occluders
from mocap.volume import (
    CameraFault,
    Carver,
    ConsistencyMonitor,
    choose_grid,
    colour_hull,
    connected_components,
    default_min_views,
    find_faults,
    find_late,
    no_occluders,
    surface_voxels,
    usable_cameras,
)
from mocap.volume.consistency import Glimpse
from mocap.volume.depth import DepthView, is_free, measured_surface
from mocap.volume.known_persons import completed, nobodys
from mocap.volume.phantoms import phantoms

_EMPTY_SHARE = 0.1
_GAP_S = 0.5  # a shorter one is bridged by the track
_MOST_GAPS = 3  # that are named one by one
_MIN_CAMERAS = 3
# For what hangs on a volume and nobody speaks against: legs that furniture hides from the others.
_HIDDEN_VOTES = 2
_AROUND_M = 0.9  # how far from a hull the unknown is of interest: the length of a hidden leg
SWINGS = 5  # frames after a push; found to as many (`python -m eval.camera_faults`)
_REMEDIES = {
    "moved": "calibrate it again, or leave these frames out",
    "lag": "find when its clip began with `mocap sync SESSION`",
    "rate": "find how fast its clock runs with `mocap sync SESSION`",
    "frozen": "leave these frames out with --frames",
    "black": "leave these frames out with --frames",
    "blind": "look at its silhouettes in the report",
    "misfit": "look at its silhouettes in the report",
    "scene": "look at the silhouettes in the report; split the recording there",
    "calibration": "calibrate it again",
    "exchanged": "exchange the clips of the two, or their names",
    "repeats": "look at how it is recorded: pictures are lost on the way, and the gaps are filled",
    "flicker": "lock its exposure, and film with steady light",
    "rig": "calibrate all cameras again, and check that all clips show the same moments",
}


def grid_of(session: Session, config: Config) -> VoxelGrid:
    """The voxel grid: configured bounds, else the session's, else the cameras' common view."""
    bounds = config.volume.room_bounds_m or session.room_bounds_m
    try:
        return choose_grid(session.rig, config.volume.voxel_size_m, bounds_m=bounds)
    except ValueError as error:
        raise MocapError(
            f"no voxel grid: {error}",
            path=session.calibration_path,
            remedy="set room_bounds_m in session.toml, or check the calibration with `mocap check`",
        ) from error


def faulty_views(session: Session, config: Config, n_excluded: int = 0) -> int:
    """The tolerance k: with `auto` one camera of six or more may be wrong when masks were computed.

    Four cameras cannot afford it: a hull of three views is half as large again. A camera that is left out has used
    up one: hulls of six good cameras without tolerance overlap the truth better (IoU 0.68 to 0.82 on the fault
    scenes) than those of six with one tolerated (0.49 to 0.59).
    """
    k = config.volume.n_faulty_views
    if k == "auto":
        k = 1 if len(session.rig) >= 6 and not session.mask_sources else 0
    return max(k - n_excluded, 0)


class _Carving:
    """Grid and carvers of a session, one carver for each set of cameras that is used."""

    def __init__(self, session: Session, config: Config, occluders: Occluders) -> None:
        self.session, self.config, self.occluders = session, config, occluders
        self.grid = grid_of(session, config)
        self.rig = session.rig
        self._carvers: dict[tuple[str, ...], Carver] = {}
        self.carver(self.rig.names)

    def carver(self, names: tuple[str, ...]) -> Carver:
        if names not in self._carvers:
            self._carvers[names] = Carver(self.rig.subset(names), self.grid, occluders=self.occluders)
        return self._carvers[names]

    def hull(
        self,
        masks: Sequence[NDArray[np.bool_]],
        pictures: Sequence[NDArray[np.uint8]] | None,
        used: NDArray[np.bool_],
        views: Sequence[DepthView] = (),
        known: NDArray[np.float64] = NOBODY,
    ) -> tuple[Hull, Voxels]:
        """The hull of one frame from the cameras in use, and the voxels around it of which nothing is known.

        known : (P, K, 3) m, keypoints on which cameras agree.
        """
        settings = self.config.volume
        rows = np.flatnonzero(used).tolist()
        carver = self.carver(tuple(self.rig.names[i] for i in rows))
        own = completed([masks[i] for i in rows], carver.rig, known)
        k = faulty_views(self.session, self.config, len(masks) - len(rows))
        min_views = None if settings.min_views == "auto" else min(settings.min_views, len(rows))

        def carved(min_views: int | None, min_votes: int | None = None) -> Voxels:
            voxels = carver.carve(
                own, n_faulty_views=k, min_views=min_views, min_votes=min_votes, outside=settings.outside_view
            )
            voxels = voxels[~nobodys(voxels, self.grid, carver.rig, known)]
            return voxels[~is_free(voxels, self.grid, views)] if views else voxels

        voxels, fewer = carved(min_views), _fewer_views(settings, len(rows))
        is_hidden = carver.occluders is not None and k == 0
        if len(voxels) and (is_hidden or fewer is not None):
            weak = carved(fewer or min_views, _HIDDEN_VOTES if is_hidden else None)
            voxels = _grown(voxels, weak, self.grid)
        is_surface = surface_voxels(voxels, self.grid)
        is_somebody = ~phantoms(voxels, is_surface, self.grid, carver.rig, own)
        voxels, is_surface = voxels[is_somebody], is_surface[is_somebody]
        unknown = np.zeros(0, dtype=np.int32)
        if carver.occluders is not None and len(voxels):
            subs, reach = self.grid.subscripts(voxels), round(_AROUND_M / self.grid.voxel_size_m)
            box = subs.min(axis=0) - reach, subs.max(axis=0) + reach + 1
            unknown = carver.unknown(own, *box, n_faulty_views=k, min_views=min_views)
            unknown = np.setdiff1d(unknown, voxels, assume_unique=True)
        images = None if pictures is None else [pictures[i] for i in rows]
        hull = colour_hull(voxels, is_surface, self.grid, carver.rig, images, settings.visibility)
        return hull, unknown

    def views(self, depth: Sequence[NDArray[np.float32]] | None, used: NDArray[np.bool_]) -> list[DepthView]:
        """What the depth cameras in use have measured.  depth : their maps, in the order of the rig, or None."""
        noise = DepthNoise(self.config.volume.depth_noise_m, self.config.volume.depth_noise_per_m)
        in_use = {name for name, is_used in zip(self.rig.names, used, strict=True) if is_used}
        maps = zip(self.session.depth_sources, depth or (), strict=depth is not None)
        return [DepthView(self.rig[name], own, noise) for name, own in maps if name in in_use]


def _fewer_views(settings: VolumeConfig, n_cameras: int) -> int | None:
    """Cameras that need to see what hangs on a person: with three or four one less than all, since who enters is cut
    by the edge of a picture; None = as many as everywhere."""
    is_free = settings.min_views == "auto" and settings.outside_view == "abstain"
    return n_cameras - 1 if is_free and 3 <= n_cameras <= default_min_views(n_cameras) else None


def _grown(voxels: Voxels, weak: Voxels, grid: VoxelGrid) -> Voxels:
    """The pieces of a weaker volume, (N,) ascending, that hold some of the voxels."""
    labels, n = connected_components(weak, grid)
    is_held = np.zeros(n, dtype=np.bool_)
    is_held[labels[np.isin(weak, voxels, assume_unique=True)]] = True
    return weak[is_held[labels]]


@dataclass(frozen=True, eq=False)
class _Walk:
    """One walk over the clip.

    monitor : looks for bad cameras among some of the rig, None = they are known.  faults : what earlier walks found.
    left_out : those whose cameras do not take part.
    """

    job: Job
    carving: _Carving
    monitor: ConsistencyMonitor | None
    faults: tuple[CameraFault, ...] = ()
    left_out: tuple[CameraFault, ...] = ()

    def used(self, seen: Seen) -> NDArray[np.bool_]:
        """(C,) the cameras that take part in a frame."""
        rig = self.carving.rig
        (used,) = usable_cameras(self.left_out, rig.names, np.array([seen.frame]))
        if self.carving.session.later_calibrations:
            used &= ~self.carving.session.is_pushed(seen.frame)
        # With fewer cameras left than a hull needs, a bad one is better than none.
        if used.sum() < min(_MIN_CAMERAS, len(rig)):
            used[:] = True
        if seen.pictures is not None:
            used &= np.array([len(picture) > 0 for picture in seen.pictures])
        return used

    @property
    def judged(self) -> list[int]:
        """The cameras that the monitor judges, by their place in the rig."""
        return (
            [] if self.monitor is None else [self.carving.rig.names.index(n) for n in self.monitor.rig.names]
        )

    def glimpse(self, seen: Seen) -> Glimpse | None:
        """What the monitor is to know of the pictures."""
        if self.monitor is None or seen.pictures is None:
            return None
        return self.monitor.glimpse([seen.pictures[c] for c in self.judged])


def _reads(job: Job) -> Sources:
    masks: Sources = {"masks": read_masks(job.store, job.session)}
    depth: Sources = {"depth": depth_of(job.session)} if job.session.depth_sources else {}
    pictures: Sources = {"pictures": pictures_of(job.session)} if job.session.image_sources else {}
    return {**masks, **pictures, **depth}


def _start(job: Job) -> _Walk:
    session, config = job.session, job.config
    try:
        is_clear = "occluders" in job.presumed
        occluders = no_occluders() if is_clear else stored_occluders(job.store, session.rig)
        carving = _Carving(session, config, occluders)
        k = faulty_views(session, config)
        if not 0 <= k < len(session.rig):
            raise ValueError(f"n_faulty_views is {k}, the rig has {len(session.rig)} cameras")
    except ValueError as error:
        raise MocapError(
            f"the volume cannot be carved: {error}",
            remedy="use larger voxels (volume.voxel_size_m), a smaller room (room_bounds_m) or fewer faulty views",
        ) from error
    is_judged = config.volume.on_bad_camera != "ignore"
    return _Walk(job, carving, _monitor(carving, session.rig) if is_judged else None)


def _monitor(carving: _Carving, rig: CameraRig) -> ConsistencyMonitor:
    """What judges the cameras of a rig over a walk."""
    n_frames = len(carving.session.frames)
    return ConsistencyMonitor(rig, carving.grid, carving.occluders, n_frames=n_frames)


def _step(walk: _Walk, seen: Seen) -> tuple[_Walk, Seen, Sequence[Row]]:
    assert seen.masks is not None
    used = walk.used(seen)
    views = walk.carving.views(seen.depth, used)
    hull, unknown = walk.carving.hull(seen.masks, seen.pictures, used, views, seen.known)
    measured = None
    if seen.depth is not None:
        measured = np.full((len(hull.voxels), 3), np.nan, dtype=np.float32)
        measured[hull.is_surface] = measured_surface(hull.voxels[hull.is_surface], hull.grid, views)
    pixels = sample_silhouettes(seen.masks, seen.pictures, used)
    row = hull_row(hull, unknown, used, pixels, measured)
    return walk, replace(seen, hull=hull, begun=walk.glimpse(seen)), [Row(PRODUCT, seen.frame, row)]


def _then(walk: _Walk, seen: Seen) -> tuple[Seen, Sequence[Row]]:
    """Hold the masks of the cameras that are judged against the hulls of the others."""
    if walk.monitor is not None:
        assert seen.masks is not None
        walk.monitor.add(seen.frame, [seen.masks[c] for c in walk.judged], seen.begun)
    return seen, ()


def _finish(walk: _Walk) -> Ending:
    """Done; or another walk, in which some cameras do not take part, or only some are judged.

    What is wrong with them is known only when the whole clip has been seen, and then from its first frame on.
    """
    if walk.monitor is None:
        return _ending(walk, walk.faults)
    session, config = walk.carving.session, walk.carving.config
    excludes = config.volume.on_bad_camera == "exclude"
    # By outlines that are guesses no calibration is judged.
    found = find_faults(walk.monitor, never_empty(walk.job.store), walk.job.each)
    late = find_late(walk.monitor, found)
    faults = walk.faults + (late or found)
    left_out = faults if excludes else ()
    if late:
        # Others are blamed because of them: they are judged again without.
        known = {fault.camera for fault in faults}
        others = walk.carving.rig.subset([n for n in walk.carving.rig.names if n not in known])
        monitor = _monitor(walk.carving, others)
        return Ending(again=replace(walk, monitor=monitor, faults=faults, left_out=left_out))
    if excludes and not usable_cameras(found, walk.carving.rig.names, np.array(session.frames)).all():
        return Ending(again=replace(walk, monitor=None, faults=faults, left_out=left_out))
    return _ending(walk, faults)


def _ending(walk: _Walk, faults: tuple[CameraFault, ...]) -> Ending:
    """What is known of the volume as a whole."""
    n_faulty = faulty_views(walk.carving.session, walk.carving.config)
    attrs = hull_attrs(walk.carving.grid, walk.carving.rig.names, n_faulty, faults)
    return Ending(attrs={PRODUCT: attrs})


def carve_report(job: Job) -> StageReport:
    """Warnings about empty hulls, and their mean volume."""
    grid, reader = stored_grid(job.store), job.store.reader(PRODUCT)
    sizes = reader.lengths("voxels")
    empty = float((sizes == 0).mean()) if sizes.size else 1.0
    warnings = []
    if empty == 1.0:
        warnings.append(
            "the volume is empty in every frame: nobody stands where enough cameras see him. Remedy: look at the "
            "silhouettes in the report, check the calibration with `mocap check`, raise volume.n_faulty_views"
        )
    elif empty > _EMPTY_SHARE:
        warnings.append(f"the volume is empty in {empty:.0%} of the frames")
    warnings += _gap_warnings(reader.frames, sizes == 0, job.session.fps)
    faults = stored_faults(job.store)
    warnings += _fault_warnings(faults, reader, job.session)
    litres = sizes * grid.voxel_size_m**3 * 1000.0
    return StageReport(
        tuple(warnings),
        {
            "mean_volume_litres": round(float(litres.mean()), 1) if sizes.size else 0.0,
            "n_faulty_views": int(reader.attrs["n_faulty_views"]),
            "grid": "x".join(map(str, grid.shape)),
            "camera_faults": len(faults),
        },
    )


def _gap_warnings(frames: NDArray[np.int64], is_empty: NDArray[np.bool_], fps: float) -> list[str]:
    """Where nobody is in the volume for a while between frames in which somebody is."""
    edges = np.flatnonzero(np.diff(is_empty.astype(np.int8)))
    starts = edges[is_empty[edges + 1]] + 1 if len(edges) else edges
    gaps = [(a, b) for a in starts for b in edges[edges >= a][:1] if (b - a + 1) >= _GAP_S * fps]
    if not gaps:
        return []
    shown = [f"{frames[a]} to {frames[b]} ({(b - a + 1) / fps:.1f} s)" for a, b in gaps[:_MOST_GAPS]]
    more = f" and {len(gaps) - len(shown)} more" if len(gaps) > len(shown) else ""
    return [
        f"nobody is in the volume in frames {', '.join(shown)}{more}, but before and after. Remedy: when people had "
        "not left, look at the silhouettes of these frames in the report: too many cameras were covered at once"
    ]


def _fault_warnings(faults: Sequence[CameraFault], reader: StageReader, session: Session) -> list[str]:
    """What is wrong with cameras, and whether they were left out."""
    if not faults:
        return []
    names = list(reader.attrs["cameras"])
    used = np.array([arrays["used"] for _, arrays in reader.rows("used")])
    warnings = []
    for fault in faults:
        inside = (reader.frames >= fault.first_frame) & (reader.frames <= fault.last_frame)
        is_out = fault.camera in names and not used[inside, names.index(fault.camera)].any()
        what = "; it is left out of the volume there" if is_out else ""
        later = [frame for frame in session.later_calibrations if frame >= fault.first_frame]
        if fault.kind == "moved" and later:
            warnings.append(
                f"{fault.message}; it is left out until another calibration holds, at frame {later[0]}"
            )
            continue
        warnings.append(f"{fault.message}{what}. Remedy: {_remedy(fault)}")
    return warnings


def _remedy(fault: CameraFault) -> str:
    if fault.kind != "moved" or fault.is_from_start or not fault.is_to_end:
        return _REMEDIES[fault.kind]
    still = fault.first_frame + SWINGS
    return (
        "find where it stands from then on: mocap calibrate --refine SESSION "
        f"--moved {fault.camera} --from-frame {still} -o SESSION/from_{still}.toml"
    )


_WORK = FrameWork(_reads, _start, _step, _finish, finds=("hull",), then=_then, apart=("masks",))
CARVE = Stage(
    name="carve",
    until="carve",
    products=(PRODUCT,),
    # Coloured hulls of every frame. Source: CF 2.2.4.
    work=_WORK,
    report=carve_report,
    needs=("segment", "occluders"),
    needs_whole=("occluders",),
    sections=("volume",),
    facts=("room_bounds_m", "depth"),
)
