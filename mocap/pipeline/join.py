"""Joining: runs of pieces of one recording that share frames become the run of the whole.

Every frame of the whole comes from one piece, in all products. Persons are the same whose landmarks are at the same
places where two pieces overlap; what the filter gave of them is put end to end and smoothed as one.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.body.model import load_body_model
from mocap.errors import MocapError
from mocap.io.session import Session, open_session
from mocap.io.store import StageReader, StageStore
from mocap.pipeline.chains import WITH_VOLUMES, stages_until
from mocap.pipeline.checks import check_out
from mocap.pipeline.config import config_hash
from mocap.pipeline.edits.model import Edits
from mocap.pipeline.finished import read_record
from mocap.pipeline.inputs import FileHashes
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.lock import sole_use
from mocap.pipeline.reach import code_hash_of
from mocap.pipeline.record import JOIN, OUTPUTS, RunRecord, RunResult, StageRecord
from mocap.pipeline.resolution import at_useful_size
from mocap.pipeline.run import found_in, publish_run
from mocap.pipeline.stage import Job, StageReport
from mocap.pipeline.stages.pose import PoseWork
from mocap.pose.deviation import widened
from mocap.pose.join import gaps_m, joined_person, same_persons, seam_frame
from mocap.pose.person import finish_person
from mocap.pose.result import FollowedPerson
from mocap.products import empty as empty_product
from mocap.products import followed as followed_product
from mocap.products import occluders as occluders_product
from mocap.products import owners as owners_product
from mocap.products import poses as poses_product
from mocap.products import tracks as tracks_product
from mocap.products.followed import read_followed, store_followed, things_in
from mocap.products.hulls import rig_offset_m, stored_grid
from mocap.products.occluders import occluder_attrs, occluder_rows, stored_occluders
from mocap.products.one_run import check_one_run
from mocap.products.poses import store_poses
from mocap.progress import Progress, no_progress
from mocap.volume.standing import nearest_of

Arrays = dict[str, NDArray[Any]]

# Products that are not joined frame by frame as they are.
_WHOLE = (
    empty_product.PRODUCT,
    occluders_product.PRODUCT,
    followed_product.PRODUCT,
    poses_product.PRODUCT,
)
# Product -> array of it that names persons. Those of keypoints are the figures' own and name no track.
_NAMES = {tracks_product.PRODUCT: "person", owners_product.PRODUCT: "owner"}
# The distance within which a landmark counts as found.
_AGREED_M = 0.1


@dataclass(frozen=True, eq=False)
class Piece:
    """The run of a piece.

    followed : its persons by number.  own : the frames that the whole has from it.  names : its number of a person ->
    that of the whole.
    """

    out: Path
    record: RunRecord
    session: Session
    followed: Mapping[int, FollowedPerson] = field(default_factory=dict)
    own: range = range(0)
    names: Mapping[int, int] = field(default_factory=dict)

    @property
    def frames(self) -> range:
        return self.record.frames

    @property
    def store(self) -> StageStore:
        return StageStore(self.out / "store.zarr")

    def reader(self, product: str) -> StageReader:
        return self.store.reader(product)


@dataclass(frozen=True, eq=False)
class Seam:
    """Where two pieces meet.  frame : the first of the later piece.  shared : frames of both.  gaps_m : person of the
    whole -> mean distance of the landmarks of both pieces in that frame.  lost, new : persons of the whole who are only
    in the earlier piece there, only in the later one."""

    frame: int
    shared: range
    gaps_m: Mapping[int, float]
    lost: tuple[int, ...]
    new: tuple[int, ...]


def join_runs(
    session: Path,
    pieces: Sequence[Path],
    out: Path,
    *,
    calibration: Path | None = None,
    progress: Progress | None = None,
    command: str = "",
) -> RunResult:
    """The run of a whole recording out of runs of its pieces, in any order; every two neighbours share frames.

    session : that all pieces were made from. Raises MocapError for pieces of other sessions, settings or versions, for
    gaps between them, and for runs that are not on volumes.
    """
    found = sorted(
        (_opened(path, session, calibration) for path in pieces), key=lambda piece: piece.frames.start
    )
    _check_same_run(found)
    _check_neighbours(found)
    _check_same_room(found)
    first = found[0].record
    config = first.config.model_copy(update={"edits": Edits()})
    frames = range(found[0].frames.start, found[-1].frames.stop)
    whole = open_session(session, calibration=calibration, frames=(frames.start, frames.stop))
    whole = at_useful_size(whole, config, first.kind)
    check_out(out, whole)
    _check_apart(found, out)
    job = Job(
        session=whole,
        config=config,
        store=StageStore(out / "store.zarr"),
        seed=first.seed,
        progress=progress or no_progress,
    )
    with sole_use(out, command):
        try:
            named, seams = _named([_with_persons(piece, job) for piece in found])
            keys = _write_products(job, named)
            steps = [*_steps(job, named, keys), _seams_step(named, seams, config_hash(*keys.values()))]
            return publish_run(
                job, out, found_in(job, first.kind, OUTPUTS), steps, until=OUTPUTS, command=command
            )
        finally:
            job.store.remove_unfinished()


def piece_frames(frames: range, n_pieces: int, n_shared: int) -> list[range]:
    """A recording in pieces of equal length; every two neighbours share so many frames.

    Raises MocapError when pieces would be shorter than twice that.
    """
    length = -(-(len(frames) + (n_pieces - 1) * n_shared) // n_pieces)
    if n_pieces > 1 and (n_shared < 1 or length < 2 * n_shared):
        raise MocapError(
            f"{len(frames)} frames cannot be cut into {n_pieces} pieces that share {n_shared} frames with the next",
            remedy="take fewer pieces, or a smaller overlap of one frame at least",
        )
    starts = [frames.start + k * (length - n_shared) for k in range(n_pieces)]
    return [range(start, min(start + length, frames.stop)) for start in starts]


def check_joinable(kind: str, path: Path) -> None:
    """Raises MocapError for what cannot be joined.  kind : what poses are found from.  path : session or run."""
    if kind not in WITH_VOLUMES:
        raise MocapError(
            f"only runs on volumes can be joined, and this one is on {kind}",
            path=path,
            remedy="run the recording as a whole; without volumes that takes little time",
        )


def _opened(path: Path, session: Path, calibration: Path | None) -> Piece:
    """The run of a piece, made from this very session with this version. Raises MocapError for any other."""
    record = read_record(path)
    if record.is_joined:
        raise MocapError(
            "the run is joined itself", path=path, remedy="join its pieces and the others at once"
        )
    check_joinable(record.kind, path)
    stages = stages_until(record.kind, "pose")
    check_one_run(path, *(product for stage in stages for product in stage.products))
    opened = open_session(session, calibration=calibration, frames=(record.frames.start, record.frames.stop))
    opened = at_useful_size(opened, record.config, record.kind)
    keys = stage_keys(opened, record.config, record.seed, record.kind, FileHashes())
    for stage in stages:
        if any(record.product_keys[product] != keys[stage.name] for product in stage.products):
            raise MocapError(
                f"the stage {stage.name} of this piece was made from other files, cameras or frames than those of "
                f"{session}, or by another version",
                path=path,
                remedy=f"run it again with `mocap run SESSION -o {path} --frames "
                f"{record.frames.start}:{record.frames.stop} --resume`",
            )
    return Piece(path, record, opened)


def _check_same_run(pieces: Sequence[Piece]) -> None:
    """Raises MocapError unless all pieces have the settings and the seed of the first."""
    if len(pieces) < 2:
        raise MocapError("there is one piece alone", remedy="name two pieces or more of one recording")
    first = _settings(pieces[0].record)
    for piece in pieces[1:]:
        own = _settings(piece.record)
        other = next((name for name in first.keys() | own.keys() if first.get(name) != own.get(name)), None)
        if other is not None:
            raise MocapError(
                f"the pieces were run with different settings: {other} is {own.get(other)}, and "
                f"{first.get(other)} in {pieces[0].out}",
                path=piece.out,
                remedy="run all pieces with the same preset, --set, --seed and --observation",
            )


def _settings(record: RunRecord) -> dict[str, str]:
    """What decides the poses of a run, besides edits and what it was made from."""
    config = record.config.model_dump(mode="json", exclude={"edits", "output"})
    sections = {name: value if isinstance(value, dict) else {"": value} for name, value in config.items()}
    flat = {
        f"{name}.{key}".rstrip("."): json.dumps(value)
        for name, section in sections.items()
        for key, value in section.items()
    }
    return {**flat, "the seed": str(record.seed), "the evidence": record.kind}


def _check_neighbours(pieces: Sequence[Piece]) -> None:
    """Raises MocapError unless every piece shares frames with the next one, and with no other."""
    for early, late in pairwise(pieces):
        a, b = early.frames, late.frames
        if b.start > a.stop:
            raise MocapError(
                f"frames {a.stop} to {b.start - 1} are in no piece",
                path=late.out,
                remedy=f"run another piece with --frames {a.start}:{b.stop}, or a little shorter",
            )
        if b.start == a.stop:
            raise MocapError(
                f"the pieces up to frame {a.stop - 1} and from frame {b.start} on share no frames: nothing tells who "
                "is who",
                path=late.out,
                remedy="begin it some 2 seconds earlier",
            )
        if b.stop <= a.stop or b.start == a.start:
            raise MocapError(
                f"the pieces {early.out} and {late.out} lie in each other",
                path=late.out,
                remedy="leave one of them out",
            )
    for early, late in zip(pieces, pieces[2:], strict=False):
        if late.frames.start < early.frames.stop:
            raise MocapError(
                f"three pieces share frame {late.frames.start}",
                path=late.out,
                remedy="leave the middle one out, or give it frames of its own",
            )


def _check_same_room(pieces: Sequence[Piece]) -> None:
    """Raises MocapError unless all pieces have the voxels and the picture sizes of the first.

    They may have calibrations of their own, where a camera was pushed.
    """
    first = pieces[0]
    grid, sizes = stored_grid(first.store), [camera.size for camera in first.session.rig]
    for piece in pieces[1:]:
        own = stored_grid(piece.store)
        is_same = own.shape == grid.shape and np.array_equal(own.origin, grid.origin)
        if not is_same or [camera.size for camera in piece.session.rig] != sizes:
            raise MocapError(
                f"the voxels or pictures of this piece are not those of {first.out}: its cameras stand elsewhere",
                path=piece.out,
                remedy="give the room in session.toml, room_bounds_m, and set segmentation.pixels_per_voxel=0",
            )


def _check_apart(pieces: Sequence[Piece], out: Path) -> None:
    if out.resolve() in (piece.out.resolve() for piece in pieces):
        raise MocapError(
            "the whole cannot take the place of one of its pieces",
            path=out,
            remedy="choose another folder with -o",
        )


def _with_persons(piece: Piece, job: Job) -> Piece:
    """The piece with its persons as the filter has followed them, without things."""
    reader, things = piece.reader(followed_product.PRODUCT), things_in(piece.store)
    persons = sorted(p for p in map(int, reader.attrs["persons"]) if p not in things)
    model = load_body_model(job.config.body_model("voxels"))
    return replace(piece, followed=read_followed(reader, persons, model, PoseWork(job).tools_of))


def _named(pieces: Sequence[Piece]) -> tuple[list[Piece], list[Seam]]:
    """Who is who: the pieces with the frames that the whole has from them and the numbers of persons in it."""
    first = pieces[0]
    named = [replace(first, own=first.frames, names={p: p for p in first.followed})]
    seams = []
    for late in pieces[1:]:
        early = named[-1]
        shared = range(late.frames.start, early.frames.stop)
        same = same_persons(list(early.followed.values()), list(late.followed.values()), shared)
        frame = seam_frame(early.followed, late.followed, same, shared)
        highest = max((n for piece in named for n in piece.names.values()), default=0)
        new = {p: highest + 1 + i for i, p in enumerate(p for p in late.followed if p not in same)}
        names = {p: early.names[same[p]] if p in same else new[p] for p in late.followed}
        named[-1] = replace(early, own=range(early.own.start, frame))
        named.append(replace(late, own=range(frame, late.frames.stop), names=names))
        here = range(frame, frame + 1)
        gaps = {
            names[p]: float(gaps_m(early.followed[q], late.followed[p], here)[0]) for p, q in same.items()
        }
        seams.append(
            Seam(
                frame,
                shared,
                {p: gap for p, gap in gaps.items() if np.isfinite(gap)},
                tuple(early.names[q] for q in _present(early, frame) if q not in same.values()),
                tuple(names[p] for p in _present(late, frame) if p not in same),
            )
        )
    return named, seams


def _present(piece: Piece, frame: int) -> Iterator[int]:
    """Persons of a piece who are in a frame of it."""
    return (p for p, one in piece.followed.items() if frame in one.frames)


def _write_products(job: Job, pieces: Sequence[Piece]) -> dict[str, str]:
    """All products of the whole into the store; stage -> key that they were made under."""
    stages = stages_until(pieces[0].record.kind, "pose")
    cuts = [(piece.own.start, piece.own.stop) for piece in pieces]
    keys = {
        stage.name: config_hash(
            JOIN,
            code_hash_of(__name__),
            repr(cuts),
            *(p.record.product_keys[stage.products[0]] for p in pieces),
        )
        for stage in stages
    }
    job.store.remove_unfinished()
    for stage in stages:
        for product in stage.products:
            if product not in _WHOLE:
                _write_frames(replace(job, key=keys[stage.name]), product, pieces)
    if any(stage.products == (occluders_product.PRODUCT,) for stage in stages):
        _write_empty(replace(job, key=keys["segment"]), pieces[0])
        _write_occluders(replace(job, key=keys["occluders"]), pieces)
    _write_persons(replace(job, key=keys["pose"]), pieces)
    return keys


def _write_frames(job: Job, product: str, pieces: Sequence[Piece]) -> None:
    """A product frame by frame, persons called by their numbers in the whole."""
    readers = [piece.reader(product) for piece in pieces]
    attrs = reduce(_both, (reader.attrs for reader in readers))
    n = len(job.session.frames)
    with job.writer(product, attrs) as out:
        for piece, reader in zip(pieces, readers, strict=True):
            for frame in piece.own:
                out.append(frame, **_renamed(product, reader.read(frame), piece.names))
                job.progress(f"{JOIN} {product}", frame + 1 - job.session.frames.start, n)


def _both(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    """What attributes say of two pieces: lists, such as warnings, put together, each entry once."""
    return {
        name: [*value, *(entry for entry in second[name] if entry not in value)]
        if isinstance(value, list) and value != second[name]
        else value
        for name, value in first.items()
    }


def _renamed(product: str, arrays: Arrays, names: Mapping[int, int]) -> Arrays:
    column = _NAMES.get(product)
    if column is None:
        return arrays
    old = arrays[column]
    new = np.zeros_like(old)  # who has no number, the 0 of nobody's voxels, keeps it
    for number, name in names.items():
        new[old == number] = name
    renamed = {**arrays, column: new}
    if product != tracks_product.PRODUCT:
        return renamed
    order = np.argsort(new, kind="stable")
    order = order[new[order] > 0]
    return {name: array[order] for name, array in renamed.items()}


def _write_empty(job: Job, piece: Piece) -> None:
    """The empty scene as a piece has learnt it."""
    with job.writer(empty_product.PRODUCT) as out:
        for c, arrays in empty_product.empty_rows(empty_product.stored_empty(piece.store)):
            out.append(c, **arrays)


def _write_occluders(job: Job, pieces: Sequence[Piece]) -> None:
    """What stands before people by what any piece has seen."""
    found = reduce(nearest_of, (stored_occluders(piece.store, piece.session.rig) for piece in pieces))
    with job.writer(occluders_product.PRODUCT, occluder_attrs(found)) as out:
        for c, arrays in occluder_rows(found, job.session.rig):
            out.append(c, **arrays)


def _write_persons(job: Job, pieces: Sequence[Piece]) -> None:
    """Every person followed, put end to end, and the poses of all, smoothed over the seams."""
    config, frames = job.config, job.session.frames
    # Each piece knows for itself how far its cameras agree.
    offset_m = np.concatenate([np.full(len(piece.own), rig_offset_m(piece.store)) for piece in pieces])
    every: list[FollowedPerson] = []
    for person in sorted({name for piece in pieces for name in piece.names.values()}):
        parts = [
            (one, piece.own)
            for piece in pieces
            for p, one in piece.followed.items()
            if piece.names[p] == person
        ]
        joined = joined_person(person, parts, config.method, PoseWork(job).tools_of)
        every += [] if joined is None else [joined]
    results = []
    for i, one in enumerate(every):
        poses = finish_person(one)
        own = offset_m[one.frames - frames.start]
        covariance = widened(poses.landmark_covariance, own, config.method.deviation)
        results.append(replace(poses, landmark_covariance=covariance))
        job.progress(f"{JOIN} poses", i + 1, len(every))
    store_followed(job.store, job.key, every, {one.person: job.key for one in every})
    store_poses(job.store, job.key, config.body_model("voxels"), results)


def _steps(
    job: Job, pieces: Sequence[Piece], keys: Mapping[str, str]
) -> Iterator[tuple[StageRecord, StageReport]]:
    """The stages as the whole has them; each has taken what it took in all pieces."""
    for stage in stages_until(pieces[0].record.kind, "pose"):
        walls = [piece.record.timings_s.get(stage.name) for piece in pieces]
        spent = [wall for wall in walls if wall is not None]
        report = stage.report(replace(job, key=keys[stage.name]))
        yield StageRecord(stage.name, keys[stage.name], sum(spent) if spent else None, report.numbers), report


def _seams_step(pieces: Sequence[Piece], seams: Sequence[Seam], key: str) -> tuple[StageRecord, StageReport]:
    """What is to be said of the seams, and of what the pieces have left out."""
    numbers = {
        "pieces": [[piece.frames.start, piece.frames.stop] for piece in pieces],
        "seams": [
            {
                "frame": seam.frame,
                "shared_frames": len(seam.shared),
                "gap_mm": {str(p): round(1000.0 * gap, 1) for p, gap in seam.gaps_m.items()},
            }
            for seam in seams
        ],
    }
    warnings = [words for seam in seams for words in _seam_words(seam)]
    warnings += [words for piece in pieces for words in things_in(piece.store).values()]
    return StageRecord(JOIN, key, None, numbers), StageReport(tuple(warnings), numbers)


def _seam_words(seam: Seam) -> Iterator[str]:
    for person, gap in seam.gaps_m.items():
        if gap > _AGREED_M:
            yield (
                f"person {person}: the pieces that meet at frame {seam.frame} have the body {1000 * gap:.0f} mm apart "
                "there: in one of them the pose is wrong. Remedy: look at the reports of both, and give pieces a "
                "larger overlap"
            )
    for persons, where in ((seam.lost, "before"), (seam.new, "after")):
        for person in persons:
            yield (
                f"person {person} is only {where} frame {seam.frame}, where two pieces meet: the other has nobody "
                "at that place. Remedy: give pieces a larger overlap, or let them meet where everybody is seen"
            )
