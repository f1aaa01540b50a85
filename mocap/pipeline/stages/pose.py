"""Pose: from hulls and tracks to poses in the store."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.body import Body
from mocap.body.initial import HeightEstimate
from mocap.body.model import load_body_model
from mocap.data import Occluders, Tracks, VoxelGrid
from mocap.data import n_judges as judges_of
from mocap.data.voxels import Voxels
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.likelihood.colours import PixelRays, person_rays
from mocap.likelihood.residuals import OutlineFitSettings, Outlines, person_outlines, pinhole_view
from mocap.pipeline.config import Config, config_hash
from mocap.pipeline.edits.meaning import check_reach, pose_edits_of, renamings_of
from mocap.pipeline.edits.model import Edits
from mocap.pipeline.pose_settings import make_tools, pose_settings
from mocap.pipeline.stage import ClipWork, Job, Stage, StageReport
from mocap.pose.deviation import widened
from mocap.pose.edits import PoseEdits, edited
from mocap.pose.evidence import PersonTools
from mocap.pose.person import VolumeClip, finish_person, follow_frames
from mocap.pose.result import FollowedPerson, PersonPoses, motion_numbers
from mocap.pose.steps import gait_numbers, gait_of, warnings_of_gait
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
from mocap.products.followed import store_followed, stored_followed
from mocap.products.hulls import measured_from_arrays, pixels_from_arrays, rig_offset_m, stored_grid
from mocap.products.masks import masks_from_arrays
from mocap.products.occluders import stored_occluders
from mocap.products.owners import owners_at
from mocap.products.poses import store_poses, stored_poses
from mocap.products.tracks import stored_tracks
from mocap.progress import Progress
from mocap.threads import in_parallel
from mocap.tracking.renaming import Renaming, renamed, renamed_tracks, sources_of
from mocap.volume import surface_voxels


def pose_stage(job: Job) -> None:
    """Poses of every tracked person into the store.

    It needs the whole clip: the first pose is looked for in several frames, a person is followed in both directions
    from there, and limbs are carried over from the frames after.  Source: CF 6.3.3, 6.5.
    """
    solve_poses(job, volumes_alone)


# Tools, hulls and number of a person -> what is seen of it.
ObservationOf = Callable[[VolumeTools, HullOf, int], VolumeObservation]


def volumes_alone(tools: VolumeTools, hull_of: HullOf, person: int) -> VolumeObservation:
    """What is seen of a person: its hulls."""
    return VolumeObservation(tools, hull_of)


def solve_poses(job: Job, observation_of: ObservationOf, others: str = "") -> None:
    """Follow every tracked person, work in the edits, and put the frames and the poses into the store.

    A person whom an earlier run has left in the store, and whom no edit of tracks concerns, is not followed again.
    others : what of other persons decides how one is followed.
    """
    config, edits = job.config, job.config.edits
    found = stored_tracks(job.store, job.session.fps)
    renamings = renamings_of(edits, found, job.session.frames)
    tracks = renamed_tracks(found, renamings)
    orders = pose_edits_of(edits, tracks, job.session.frames)
    keys = {
        p: config_hash(job.unedited_key, repr(sources_of(found, renamings, p)), others)
        for p in tracks.persons
    }
    model = load_body_model(config.body_model("voxels"))
    kept = stored_followed(job.store, keys, model, partial(_person_tools, job)) if job.is_resumed else {}
    work = PoseWork(job.session, config, job.store, renamings, observation_of)
    wanted = tracks.of(*(p for p in tracks.persons if p not in kept))
    followed = follow_tracks(work, wanted, seed=job.seed, n_threads=job.n_threads, progress=job.progress)
    every = sorted([*kept.values(), *followed], key=lambda one: one.person)
    results = [finished(work, work.edited(one, orders.get(one.person), edits)) for one in every]
    # Both or none: an edit that cannot be leaves the store as it was.
    store_followed(job.store, job.key, every, keys)
    store_poses(job.store, job.key, config.body_model("voxels"), results)


def _person_tools(job: Job, body: Body) -> PersonTools:
    settings = pose_settings(job.config.pose, job.config.method, body.layout)
    return PersonTools(body, job.session.fps, settings, 1)


@dataclass(frozen=True, eq=False)
class PoseWork:
    """What persons are followed in: products in the store, called as the edits say."""

    session: Session
    config: Config
    store: StageStore
    renamings: Sequence[Renaming] = ()
    observation_of: ObservationOf = volumes_alone

    def tools(self, height_m: float, n_threads: int) -> VolumeTools:
        """Tools of a person of a height."""
        config = self.config
        model = config.body_model("voxels")
        return make_tools(
            stored_grid(self.store),
            self.session.fps,
            height_m,
            model,
            config.pose,
            config.likelihood,
            n_threads,
            config.method,
        )

    def hull_of(self, person: int) -> HullOf:
        """frame -> the voxels of a person."""
        return hulls_of_person(self.session, self.store, person, self.renamings)

    def edited(self, one: FollowedPerson, orders: PoseEdits | None, edits: Edits) -> FollowedPerson:
        """A followed person with its edits worked in. Raises MocapError for a pin that no limb can reach."""
        if orders is None:
            return one
        limit_m = self.config.method.edits.reach_m
        check_reach(edits, one.person, one.body, one.frames, one.series.states, limit_m)
        tools = self.tools(one.height.height_m, 1).with_body(one.body)
        weight = one.tools.settings.outline_weight
        tools = replace(tools, settings=replace(tools.settings, outline_weight=weight))
        observation = self.observation_of(tools, self.hull_of(one.person), one.person)

        @lru_cache(maxsize=64)
        def evidence_of(row: int) -> VolumeEvidence | None:
            prepared = observation.prepare(int(one.frames[row]))
            return None if prepared is None else observation.evidence(prepared)

        return edited(one, orders, evidence_of)


def estimate_poses(
    session: Session,
    config: Config,
    store: StageStore,
    tracks: Tracks,
    *,
    seed: int,
    n_threads: int,
    progress: Progress,
    observation_of: ObservationOf = volumes_alone,
) -> list[PersonPoses]:
    """Poses of every tracked person, one filter each, from the products of the earlier stages in the store."""
    work = PoseWork(session, config, store, observation_of=observation_of)
    followed = follow_tracks(work, tracks, seed=seed, n_threads=n_threads, progress=progress)
    return [finished(work, one) for one in followed]


def follow_tracks(
    work: PoseWork, tracks: Tracks, *, seed: int, n_threads: int, progress: Progress
) -> list[FollowedPerson]:
    """Every tracked person, followed.

    Several persons share the threads, one each; a single one has them all. The result is the same.
    """
    config, session = work.config, work.session
    grid = stored_grid(work.store)
    given = (
        config.body.height_m
        or load_body_model(config.body_model("voxels")).height_m
        or session.person_height_m
    )
    n_of_person = n_threads if len(tracks.persons) < 2 else 1
    n_total = len(tracks)
    done, counting = 0, Lock()

    def tick(n: int) -> None:
        nonlocal done
        with counting:
            done += n
            progress("pose", done, n_total)

    def followed_of(person: int) -> FollowedPerson:
        own = tracks.of(person)
        hull_of = work.hull_of(person)
        height = (
            HeightEstimate(given, True)
            if given is not None
            else estimate_height(grid, hull_of, own.frame.tolist())
        )
        tools = work.tools(height.height_m, n_of_person)
        return follow_frames(
            VolumeClip(person, own.frame, own.xyz, work.observation_of(tools, hull_of, person)),
            height,
            seed=seed,
            is_size_fitted=given is None and config.body.sizing == "poses" and config.pose.refine,
            progress=tick,
        )

    return in_parallel(followed_of, tracks.persons, n_threads)


def finished(work: PoseWork, one: FollowedPerson) -> PersonPoses:
    """The poses of a followed person, as uncertain as the cameras' agreement leaves them."""
    poses = finish_person(one)
    covariance = widened(poses.landmark_covariance, rig_offset_m(work.store), work.config.method.deviation)
    return replace(poses, landmark_covariance=covariance)


def hulls_of_person(
    session: Session, store: StageStore, person: int, renamings: Sequence[Renaming] = ()
) -> HullOf:
    """frame -> the voxels of one person, with its outlines, from the products of the earlier stages.

    renamings : what owners are called.
    """
    views = PersonViews(session, stored_grid(store), stored_occluders(store, session.rig))
    hulls, segments = store.reader(hulls_product.PRODUCT), store.reader(masks_product.PRODUCT)
    owners = store.reader(owners_product.PRODUCT)

    @lru_cache(maxsize=8)
    def hull_of(frame: int) -> PersonHull | None:
        owner = renamed(owners_at(owners, frame), frame, renamings)
        return views.hull(hulls.read(frame), owner, person, lambda: segments.read(frame))

    return hull_of


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
    ) -> PersonHull | None:
        """The person's voxels and how its outlines and rays are made; None without a voxel.

        arrays, segmented : rows of hulls and, when outlines are asked for, of masks.  owner : (N,) of the hull's
        voxels, 0 = nobody.  person : as `owner` calls it.
        """
        rig, grid, occluders = self._session.rig, self._grid, self._occluders
        keep = owner == person
        if not keep.any():
            return None
        # Surface of the person alone, so that a neighbour does not hide a side of him.
        voxels = arrays["voxels"][keep].astype(np.int32, copy=False)
        unknown = arrays["unknown"].astype(np.int32, copy=False)
        is_surface = surface_towards_air(voxels, unknown, grid)
        others = arrays["voxels"][(owner > 0) & ~keep & arrays["is_surface"].astype(np.bool_)]

        @lru_cache(maxsize=1)
        def outlines() -> Outlines:
            found, surface = segmented(), grid.centers(voxels[is_surface])
            return person_outlines(
                self._views,
                rig,
                masks_from_arrays(found, self._session),
                surface,
                grid.centers(others.astype(np.int32)),
                n_points=OutlineFitSettings().n_outline_points,
                is_whole=found["usable"] & arrays["used"].astype(np.bool_),
                hidden=[occluders.hidden_pixels(camera, surface) for camera in rig],
            )

        @lru_cache(maxsize=1)
        def rays() -> PixelRays:
            surface = grid.centers(voxels[is_surface])
            return person_rays(
                rig, pixels_from_arrays(arrays), surface, grid.centers(others.astype(np.int32))
            )

        used = [name for name, is_used in zip(rig.names, arrays["used"], strict=True) if is_used]
        n_judges = partial(judges_of, rig.subset(used), occluders=occluders)
        measured = measured_from_arrays(arrays)
        return PersonHull(
            voxels,
            is_surface,
            outlines,
            rays,
            unknown,
            None if occluders.is_empty else n_judges,
            None if measured is None else measured[keep],
        )


def surface_towards_air(voxels: Voxels, unknown: Voxels, grid: VoxelGrid) -> NDArray[np.bool_]:
    """Which voxels (N,) have an empty neighbour; where the next is unknown nobody has seen a surface."""
    if len(unknown) == 0:
        return surface_voxels(voxels, grid)
    both = np.union1d(voxels, unknown)
    return surface_voxels(both, grid)[np.searchsorted(both, voxels)]


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
            **_rounded(gait_numbers(gaits[p.person])),
        }
        for p in poses
    }
    warnings = [w for p in poses for w in (*p.warnings, *warnings_of_gait(p, gaits[p.person], settings))]
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
