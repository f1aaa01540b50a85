"""Pose: from hulls and tracks to poses in the store."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from threading import Lock
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Image, Mask, frames_in_words
from mocap.body import Body
from mocap.body.initial import HeightEstimate
from mocap.body.model import load_body_model
from mocap.data import Occluders, Tracks, VoxelGrid
from mocap.data import n_judges as judges_of
from mocap.data.keypoints import NOBODY
from mocap.forks import can_fork
from mocap.io.session import Session
from mocap.io.session.reading import pictures_of
from mocap.io.store import StageStore
from mocap.likelihood.colours import PixelRays, person_rays
from mocap.likelihood.residuals import (
    Crops,
    OutlineFitSettings,
    Outlines,
    person_crops,
    person_outlines,
    pinhole_view,
)
from mocap.pipeline.edits.followed import solve_persons
from mocap.pipeline.pose_settings import make_tools, pose_settings, stated_height_m
from mocap.pipeline.stage import ClipWork, Job, Stage, StageReport
from mocap.pose.deviation import widened
from mocap.pose.evidence import PersonTools
from mocap.pose.marker_person import flesh_centroids
from mocap.pose.moves import move_numbers, moves_of
from mocap.pose.person import VolumeClip, finish_person, follow_frames
from mocap.pose.result import FollowedPerson, PersonPoses, motion_numbers
from mocap.pose.steps import gait_numbers, gait_of, warnings_of_gait
from mocap.pose.thing import Look, is_like_nobody, is_thing
from mocap.pose.volume import (
    HullOf,
    PersonHull,
    VolumeEvidence,
    VolumeObservation,
    VolumeTools,
    estimate_height,
)
from mocap.products import followed as followed_product
from mocap.products import hulls as hulls_product
from mocap.products import masks as masks_product
from mocap.products import owners as owners_product
from mocap.products import poses as poses_product
from mocap.products.followed import things_in
from mocap.products.hulls import measured_from_arrays, pixels_from_arrays, rig_offset_m, stored_grid
from mocap.products.masks import masks_from_arrays
from mocap.products.occluders import stored_occluders
from mocap.products.owners import owners_at
from mocap.products.poses import stored_poses
from mocap.products.tracks import stored_tracks
from mocap.threads import in_parallel
from mocap.tracking.renaming import Renaming, renamed
from mocap.volume import surface_voxels
from mocap.volume.known_persons import missing_parts
from mocap.volume.lost_legs import lost_legs


def pose_stage(job: Job) -> None:
    """Poses of every tracked person into the store.

    It needs the whole clip: the first pose is looked for in several frames, a person is followed in both directions
    from there, and limbs are carried over from the frames after.  Source: CF 6.3.3, 6.5.
    """
    solve_poses(job, volumes_alone)


# Tools, hulls and number of a person -> what is seen of it.
ObservationOf = Callable[[VolumeTools, HullOf, int], VolumeObservation]

# Frame -> the keypoints (P, K, 3) m of the persons on whom cameras agree.
KnownPoints = Mapping[int, NDArray[np.float64]]
NOTHING_KNOWN: KnownPoints = MappingProxyType({})


def volumes_alone(tools: VolumeTools, hull_of: HullOf, person: int) -> VolumeObservation:
    """What is seen of a person: its hulls."""
    return VolumeObservation(tools, hull_of)


def solve_poses(
    job: Job, observation_of: ObservationOf, others: str = "", known: KnownPoints = NOTHING_KNOWN
) -> None:
    """Poses of every person in the stored tracks, from volumes, into the store.  others : as in `solve_persons`."""
    found = stored_tracks(job.store, job.session.fps)
    solve_persons(
        job, found, "voxels", lambda renamings: PoseWork(job, renamings, observation_of, known), others
    )


def look_at(arrays: Mapping[str, NDArray[Any]], is_own: Mask, grid: VoxelGrid) -> Look:
    """What is seen of those voxels of a hull that `is_own`, (N,).  arrays : its row of hulls, with colours."""
    is_seen = is_own & arrays["is_surface"].astype(np.bool_) & (arrays["n_views"] > 0)
    voxels = arrays["voxels"].astype(np.int32)
    return Look(grid.centers(voxels[is_own]), voxels[is_seen], arrays["rgb"][is_seen])


@dataclass(frozen=True, eq=False)
class PoseWork:
    """What persons are followed in: products in the store, called as the edits say. Implements `PersonsWork`."""

    job: Job
    renamings: Sequence[Renaming] = ()
    observation_of: ObservationOf = volumes_alone
    known: KnownPoints = field(default_factory=dict)

    def tools(self, height_m: float, n_threads: int) -> VolumeTools:
        """Tools of a person of a height."""
        config = self.job.config
        model = config.body_model("voxels")
        return make_tools(
            stored_grid(self.job.store),
            self.job.session.fps,
            height_m,
            model,
            config.pose,
            config.likelihood,
            n_threads,
            config.method,
        )

    def tools_of(self, body: Body, marker_offsets: NDArray[np.float64] | None = None) -> PersonTools:
        """What a person is followed with whose body is known already, less its look-up table."""
        config = self.job.config
        settings = pose_settings(config.pose, config.method, body.layout)
        return PersonTools(body, self.job.session.fps, settings, 1)

    def hull_of(self, person: int) -> HullOf:
        """frame -> the voxels of a person."""
        return hulls_of_person(self.job.session, self.job.store, person, self.renamings, self.known)

    def evidence_of(self, one: FollowedPerson) -> Callable[[int], VolumeEvidence | None]:
        """Row of a person -> its hull with the body of that person."""
        tools = self.tools(one.height.height_m, 1).with_body(one.body)
        weight = one.tools.settings.outline_weight
        tools = replace(tools, settings=replace(tools.settings, outline_weight=weight))
        observation = self.observation_of(tools, self.hull_of(one.person), one.person)

        @lru_cache(maxsize=64)
        def evidence_of(row: int) -> VolumeEvidence | None:
            prepared = observation.prepare(int(one.frames[row]))
            return None if prepared is None else observation.evidence(prepared)

        return evidence_of

    def follow(self, tracks: Tracks) -> list[FollowedPerson]:
        """Every tracked person.

        One after the other with all threads where a person's ways can be followed in two processes; elsewhere several
        persons share the threads, one each. The result is the same.
        """
        config, session = self.job.config, self.job.session
        grid, n_threads = stored_grid(self.job.store), self.job.n_threads
        given = stated_height_m(config, load_body_model(config.body_model("voxels")), session)
        n_at_once = 1 if can_fork() else min(n_threads, len(tracks.persons))
        n_of_person = n_threads if n_at_once == 1 else 1
        n_total = len(tracks)
        done, counting = 0, Lock()

        def tick(n: int) -> None:
            nonlocal done
            with counting:
                done += n
                self.job.progress("pose", done, n_total)

        def followed_of(person: int) -> FollowedPerson:
            own = tracks.of(person)
            hull_of = self.hull_of(person)
            height = (
                HeightEstimate(given, True, is_given=True)
                if given is not None
                else estimate_height(grid, hull_of, own.frame.tolist())
            )
            tools = self.tools(height.height_m, n_of_person)
            observation = self.observation_of(tools, hull_of, person)
            if session.image_sources:
                observation = replace(observation, pictures_of=partial(pictures_of, session))
            followed = follow_frames(
                VolumeClip(person, own.frame, own.xyz, observation),
                height,
                seed=self.job.seed,
                is_size_fitted=config.body.sizing == "poses" and config.pose.refine,
                progress=tick,
            )
            return self._told(followed, own)

        return in_parallel(followed_of, tracks.persons, n_at_once)

    def _told(self, followed: FollowedPerson, track: Tracks) -> FollowedPerson:
        """The same, with what is said of a thing where it is one."""
        numbers, series, grid = self.job.config.method.thing, followed.series, stored_grid(self.job.store)
        misfit = series.misfit.sum(axis=1)[series.blind_std == 0]
        is_short = len(track) < numbers.least_s * followed.tools.fps
        if is_short or not is_like_nobody(track.xyz, misfit, numbers):
            return followed
        rows = np.unique(np.linspace(0, len(track) - 1, numbers.n_looks).astype(int))
        looks = list(self._looks(followed.person, track.frame[rows].tolist(), grid))
        if not is_thing(looks, grid.voxel_size_m, numbers):
            return followed
        x, y = np.median(track.xyz[:, :2], axis=0)
        words = (
            f"what stands at ({x:.2f}, {y:.2f}) m in frames {frames_in_words(track.frame)} was tracked as person "
            f"{followed.person} and is left out: it keeps still, has no head and no pose explains it, so that it "
            "seems a thing that the empty scene does not have. Remedy: take it away, or record an empty clip with it; "
            "if it is somebody, --set method.thing.stays_m=0"
        )
        return replace(followed, thing=words)

    def _looks(self, person: int, frames: Sequence[int], grid: VoxelGrid) -> Iterator[Look]:
        """The volume of a person in some frames, and its colours."""
        hulls, owners = (self.job.store.reader(p) for p in (hulls_product.PRODUCT, owners_product.PRODUCT))
        for frame in frames:
            arrays = hulls.read(frame, ["voxels", "is_surface", "n_views", "rgb"])
            is_own = renamed(owners_at(owners, frame), frame, self.renamings) == person
            yield look_at(arrays, is_own, grid)

    def finished(self, one: FollowedPerson) -> PersonPoses:
        """The poses of a followed person, as uncertain as the cameras' agreement leaves them."""
        poses, numbers = finish_person(one), self.job.config.method.deviation
        covariance = widened(poses.landmark_covariance, rig_offset_m(self.job.store), numbers)
        return replace(poses, landmark_covariance=covariance)


def estimate_poses(job: Job, tracks: Tracks) -> list[PersonPoses]:
    """Poses of every tracked person, one filter each, from the products of the earlier stages in the store."""
    work = PoseWork(job)
    return [work.finished(one) for one in work.follow(tracks)]


def hulls_of_person(
    session: Session,
    store: StageStore,
    person: int,
    renamings: Sequence[Renaming] = (),
    known: KnownPoints = NOTHING_KNOWN,
) -> HullOf:
    """frame -> the voxels of one person, with its outlines, from the products of the earlier stages.

    renamings : what owners are called.  known : where keypoints say what silhouettes lack.
    """
    views = PersonViews(session, stored_grid(store), stored_occluders(store, session.rig))
    hulls, segments = store.reader(hulls_product.PRODUCT), store.reader(masks_product.PRODUCT)
    owners = store.reader(owners_product.PRODUCT)
    # Nearly half of what would be decoded, and no pose asks for it.
    asked_for = [name for name in hulls.names if name not in ("n_views", "rgb")]

    @lru_cache(maxsize=8)
    def hull_of(frame: int) -> PersonHull | None:
        owner = renamed(owners_at(owners, frame), frame, renamings)
        return views.hull(
            hulls.read(frame, asked_for),
            owner,
            person,
            lambda: segments.read(frame),
            known.get(frame, NOBODY),
        )

    return hull_of


def _either(a: Mask | None, b: Mask | None) -> Mask | None:
    """What is in one of two masks, None = nothing."""
    return b if a is None else a if b is None else a | b


class PersonViews:
    """What is seen of one person in a frame, out of the rows that the earlier stages have made of it."""

    def __init__(self, session: Session, grid: VoxelGrid, occluders: Occluders) -> None:
        self._session, self._grid, self._occluders = session, grid, occluders
        self._views = [pinhole_view(camera) for camera in session.rig]

    def hull(
        self,
        arrays: Mapping[str, NDArray[Any]],
        owner: NDArray[np.unsignedinteger[Any]],
        person: int,
        segmented: Callable[[], Mapping[str, NDArray[Any]]],
        known: NDArray[np.float64] = NOBODY,
    ) -> PersonHull | None:
        """The person's voxels and how its outlines and rays are made; None without a voxel.

        arrays, segmented : rows of hulls and, when outlines are asked for, of masks.  owner : (N,) of the hull's
        voxels, 0 = nobody.  person : as `owner` calls it.  known : (P, K, 3) m, keypoints on which cameras agree.
        """
        rig, grid, occluders = self._session.rig, self._grid, self._occluders
        keep = owner == person
        if not keep.any():
            return None
        # Surface of the person alone, so that a neighbour does not hide a side of him.
        voxels = arrays["voxels"][keep].astype(np.int32, copy=False)
        # Where masks have lost his legs nothing is known of them: they are not in the air.
        unknown = arrays["unknown"].astype(np.int32, copy=False)
        if len(legs := lost_legs(voxels, grid)):
            unknown = np.union1d(unknown, legs)
        is_surface = surface_voxels(voxels, grid, unknown, beyond_is_empty=False)
        others = arrays["voxels"][(owner > 0) & ~keep & arrays["is_surface"].astype(np.bool_)]

        @lru_cache(maxsize=1)
        def outlines() -> Outlines:
            found, surface = segmented(), grid.centers(voxels[is_surface])
            masks = masks_from_arrays(found, self._session)
            lacks = missing_parts(masks, rig, known)
            hidden = [
                _either(occluders.hidden_pixels(camera, surface), lacking)
                for camera, lacking in zip(rig, lacks, strict=True)
            ]
            return person_outlines(
                self._views,
                rig,
                masks,
                surface,
                grid.centers(others.astype(np.int32)),
                n_points=OutlineFitSettings().n_outline_points,
                is_whole=found["usable"] & arrays["used"].astype(np.bool_),
                hidden=hidden,
            )

        @lru_cache(maxsize=1)
        def rays() -> PixelRays:
            surface = grid.centers(voxels[is_surface])
            return person_rays(
                rig, pixels_from_arrays(arrays), surface, grid.centers(others.astype(np.int32))
            )

        def crops(pictures: Sequence[Image]) -> Crops:
            surface = grid.centers(voxels[is_surface])
            return person_crops(
                self._views,
                pictures,
                surface,
                grid.centers(others.astype(np.int32)),
                is_used=arrays["used"].astype(np.bool_),
                hidden=[occluders.hidden_pixels(camera, surface) for camera in rig],
            )

        used = [name for name, is_used in zip(rig.names, arrays["used"], strict=True) if is_used]
        n_judges = partial(judges_of, rig.subset(used), occluders=occluders)
        measured = measured_from_arrays(arrays)
        return PersonHull(
            voxels,
            is_surface,
            outlines,
            rays,
            crops,
            unknown,
            n_judges,
            not occluders.is_empty,
            None if measured is None else measured[keep],
        )


def tracks_of_flesh(results: Sequence[PersonPoses], fps: float) -> Tracks:
    """The persons' paths: centres of their flesh."""
    frame = np.concatenate([np.zeros(0, dtype=np.int64), *(p.frames for p in results)])
    person: NDArray[np.int64] = np.concatenate(
        [np.zeros(0, dtype=np.int64), *(np.full(len(p.frames), p.person, dtype=np.int64) for p in results)]
    )
    xyz = np.concatenate([np.zeros((0, 3)), *(flesh_centroids(p.body, p.states) for p in results)])
    order = np.lexsort((person, frame))
    return Tracks(frame[order], person[order], frame[order] / fps, xyz[order])


def poses_report(job: Job) -> StageReport:
    """Size, frames and calmness of every person, and what the poses warn of."""
    fps = job.session.fps
    poses = stored_poses(job.store)
    settings = job.config.method.contact
    gaits = {p.person: gait_of(p, fps, settings) for p in poses}
    persons = {
        str(p.person): {
            "height_m": round(p.height.height_m, 3),
            "first_frame": int(p.frames[0]),
            "last_frame": int(p.frames[-1]),
            "start_frame": p.start_frame,
            **motion_numbers(p, fps),
            **_rounded({**gait_numbers(gaits[p.person]), **move_numbers(moves_of(p, gaits[p.person], fps))}),
        }
        for p in poses
    }
    warnings = [w for p in poses for w in (*p.warnings, *warnings_of_gait(p, gaits[p.person], fps, settings))]
    warnings += things_in(job.store).values()
    return StageReport(tuple(warnings), {"persons": persons})


def _rounded(numbers: dict[str, float | None]) -> dict[str, float | None]:
    return {name: None if value is None else round(value, 3) for name, value in numbers.items()}


POSE = Stage(
    name="pose",
    until="pose",
    products=(followed_product.PRODUCT, poses_product.PRODUCT),
    work=ClipWork(pose_stage),
    report=poses_report,
    needs=("track",),
    sections=("body", "likelihood", "pose", "method", "edits"),
    facts=("fps", "person_height_m"),
    is_random=lambda config: True,
)
