"""Particles of a finished run: the filter is run once more in some frames, to be looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mocap.body import landmarks_of
from mocap.errors import MocapError
from mocap.pipeline.edits.meaning import renamings_of
from mocap.pipeline.record import RunResult
from mocap.pipeline.scene_frames import LayersOf, rows_at
from mocap.pipeline.stage import Job
from mocap.pipeline.stages.pose import PoseWork
from mocap.pose.layers import layers_from
from mocap.pose.result import PersonPoses
from mocap.products.tracks import stored_tracks
from mocap.rng import rng_for

Array = NDArray[np.float64]

# A second of film; 4800 points a frame and person are 2 MB a second.
MOST_FRAMES = 60
# Where particles are drawn: the ends of limbs, where they differ most.
_SHOWN = ("head", "left_wrist", "right_wrist", "left_ankle", "right_ankle")


def particle_layers(run: RunResult, frames: tuple[int | None, int | None]) -> LayersOf:
    """frame -> person -> the ends of the limbs of all particles, layer by layer; nothing outside of `frames`.

    The filter starts from the pose of the frame before: a run does not keep its particles. Raises MocapError for frames
    that are not the run's, for too many, and for a run that is not on volumes alone.
    """
    clip, record = run.session.frames, run.record
    wanted = range(
        clip.start if frames[0] is None else frames[0], clip.stop if frames[1] is None else frames[1]
    )
    if not wanted or wanted.start < clip.start or wanted.stop > clip.stop or len(wanted) > MOST_FRAMES:
        raise MocapError(
            f"--particles is {wanted.start}:{wanted.stop}; the run has frames {clip.start} to {clip.stop - 1}",
            remedy=f"give a:b within them, {MOST_FRAMES} frames at most",
        )
    if record.kind != "voxels":
        raise MocapError(
            f"the run is on {record.kind}: only filters on volumes alone can be looked at",
            path=run.out,
            remedy="run the session with --observation voxels",
        )
    renamings = renamings_of(record.config.edits, stored_tracks(run.found.store, record.fps), clip)
    work = PoseWork(Job(run.session, record.config, run.found.store), renamings)
    return lambda frame: _of_frame(work, run, frame) if frame in wanted else {}


def _of_frame(work: PoseWork, run: RunResult, frame: int) -> Mapping[int, Sequence[Array]]:
    found = {}
    for poses, row in rows_at(run.poses, frame):
        tools = work.tools(poses.height.height_m, 1).with_body(poses.body)
        observation = work.observation_of(tools, work.hull_of(poses.person), poses.person)
        prepared = observation.prepare(frame)
        if prepared is None:
            continue
        rng = rng_for(run.record.seed, "pose", poses.person, frame)
        try:
            layers = layers_from(observation.evidence(prepared), poses.states[max(row - 1, 0)], rng=rng)
        except (TypeError, ValueError) as error:
            raise MocapError(
                f"the filter {work.job.config.pose.filter} cannot be looked at: {error}",
                remedy="take apf, sir or another filter of whole bodies",
            ) from error
        found[poses.person] = [_ends(poses, layer.particles) for layer in layers]
    return found


def _ends(poses: PersonPoses, particles: Array) -> Array:
    """The ends of the limbs of particles (N, D), (K, 3) m."""
    at = [poses.body.landmarks.index(name) for name in _SHOWN if name in poses.body.landmarks]
    return landmarks_of(poses.body, particles)[:, at].reshape(-1, 3)
