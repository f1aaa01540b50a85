"""A finished run read back from its folder, to write its report or its 3D scene again without running anything."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from mocap.errors import MocapError, did_you_mean
from mocap.files import load_json
from mocap.io._files import writing
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.pipeline.edits.beside import tracks_after, tracks_before
from mocap.pipeline.edits.meaning import check_reach, pose_edits_of, renamings_of
from mocap.pipeline.edits.model import Edits, PinLandmark
from mocap.pipeline.lock import sole_use
from mocap.pipeline.outside import check_outside
from mocap.pipeline.overlay_video import overlay_videos
from mocap.pipeline.particles import particle_layers
from mocap.pipeline.pictures import read_pictures
from mocap.pipeline.record import OUTPUTS, Found, RunRecord, RunResult, record_from_json
from mocap.pipeline.report_data import write_run_report
from mocap.pipeline.resolution import at_useful_size
from mocap.pipeline.run import run_session
from mocap.pipeline.scene_frames import write_scene
from mocap.pose.doubt import Doubt, doubts_of_all
from mocap.products import poses as poses_product
from mocap.products import tracks as tracks_product
from mocap.products.one_run import check_one_run
from mocap.products.poses import stored_poses
from mocap.progress import Progress, no_progress
from mocap.tracking.renaming import renamed_tracks


def open_run(out: Path, session: Path) -> RunResult:
    """Read the run in `out`, timings to the millisecond; `session` is the folder that it was made from.

    Raises MocapError when there is no complete run, when its settings are of another version, or when the session has
    other cameras, frames or frame rate than the run.
    """
    record = read_record(out)
    check_one_run(out)
    if record.until not in ("pose", OUTPUTS):
        raise MocapError(
            f"the run is {record.status} and has no poses",
            path=out / "run.json",
            remedy="finish it with `mocap run SESSION -o OUT --resume`",
        )
    opened = open_session(session, frames=(record.frames.start, record.frames.stop))
    _check_same(record, opened, out)
    opened = at_useful_size(opened, record.config, record.kind)
    store = StageStore(out / "store.zarr")
    tracks = tracks_after(store, record.kind, opened, record.config.edits, has_poses=True)
    found = Found(opened, store, record.kind, tracks, tuple(stored_poses(store)), record.config.method)
    return RunResult(record, out, found)


def rewrite_report(out: Path, session: Path) -> Path:
    """report.html of a finished run, written again from its tables and its store; gives the file."""
    path = out / "report.html"
    with sole_use(_folder_of_run(out), f"mocap report {out}"), writing(path):
        write_run_report(open_run(out, session), path)
    return path


def open_scene(path: Path) -> None:
    """Open a 3D scene in the Rerun viewer, which lives on its own. Raises MissingExtra."""
    from mocap.view.viewer import start_viewer

    start_viewer(str(path))


def rewrite_scene(
    out: Path,
    session: Path,
    path: Path | None = None,
    *,
    pictures: Sequence[str] | None = None,
    particles: tuple[int | None, int | None] | None = None,
) -> Path:
    """The Rerun scene of a finished run, into OUT/scene.rrd or another file; gives the file.

    pictures : cameras whose pictures it holds, None = all.  particles : (start, stop), frames in which the particles of
    every layer are shown; None = in none.
    """
    target = out / "scene.rrd" if path is None else path
    if path is not None:
        check_outside(path, session)
    with sole_use(_folder_of_run(out), f"mocap view {out}"):
        run = open_run(out, session)
        check_cameras(run.found, pictures, "--pictures")
        layers_of = None if particles is None else particle_layers(run, particles)
        shown = read_pictures(run.found, scene=pictures).scene
        write_scene(run.found, target, pictures=lambda: shown, layers_of=layers_of)
    return target


def write_overlays(
    out: Path, session: Path, *, cameras: Sequence[str] | None = None, progress: Progress = no_progress
) -> list[Path]:
    """A video per camera of a finished run with the bodies drawn in, OUT/overlay_CAMERA.mp4; gives the files."""
    with sole_use(_folder_of_run(out), f"mocap report {out} --video"), writing(out):
        found = open_run(out, session).found
        check_cameras(found, cameras, "--cameras")
        return overlay_videos(found, out, cameras=cameras, progress=progress)


def run_again(
    out: Path,
    session: Path,
    *,
    calibration: Path | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> RunResult:
    """The run in `out` once more, with its settings, seed and frames and the edits that lie beside it; what does not
    depend on them is taken over."""
    record = read_record(out)
    _check_not_joined(record, out)
    return run_session(
        session,
        out,
        config=record.config.model_copy(update={"edits": Edits()}),
        seed=record.seed,
        until=record.until,
        resume=True,
        frames=(record.frames.start, record.frames.stop),
        calibration=calibration,
        n_threads=n_threads,
        progress=progress,
        command=record.command,
    )


def check_edits(out: Path, edits: Edits) -> None:
    """Edits against the tracks of the run in `out`, as far as that can be told without its session.

    Raises MocapError for edits that cannot be.
    """
    record = read_record(out)
    _check_not_joined(record, out)
    store = StageStore(out / "store.zarr")
    check_one_run(out, tracks_product.PRODUCT)
    tracks = tracks_before(store, record.kind, record.frames, record.fps)
    renamings = renamings_of(edits, tracks, record.frames)
    pose_edits_of(edits, renamed_tracks(tracks, renamings), record.frames)
    for pin in edits.of(PinLandmark):
        for camera in pin.seen_px or {}:
            if camera not in record.cameras:
                known = ", ".join(record.cameras)
                meant = did_you_mean(camera, record.cameras)
                raise edits.wrong(pin, f"there is no camera {camera!r}{meant}", f"cameras are {known}")
    if not renamings and poses_product.PRODUCT in record.product_keys:
        for p in stored_poses(store):
            check_reach(edits, p.person, p.body, p.frames, p.states, record.config.method.edits.reach_m)


def doubts_in(out: Path) -> list[Doubt]:
    """The frames of the run in `out` that are worth looking at, most doubtful first."""
    record = read_record(out)
    check_one_run(out, poses_product.PRODUCT)
    poses = stored_poses(StageStore(out / "store.zarr"))
    return doubts_of_all(poses, record.fps, record.config.method.doubt)


def check_cameras(found: Found, names: Sequence[str] | None, option: str) -> None:
    """Raises MocapError, which names the option, for a camera that the session does not have."""
    known = found.session.rig.names
    for name in names or ():
        if name not in known:
            raise MocapError(
                f"{option}: there is no camera {name!r}{did_you_mean(name, known)}",
                path=found.session.root,
                remedy=f"name some of {', '.join(known)}",
            )


def read_record(out: Path) -> RunRecord:
    """The record of the run in `out`. Raises MocapError when there is none, or one of another version."""
    path = out / "run.json"
    try:
        return record_from_json(load_json(path))
    except ValidationError as error:
        raise MocapError(
            f"the run has settings that this version does not know: {error.errors()[0]['msg']}",
            path=path,
            remedy="run the session again",
        ) from error
    except (KeyError, AttributeError) as error:
        raise MocapError(
            f"run.json says nothing of {error.args[0]}",
            path=path,
            remedy="run the session again with this version",
        ) from error
    except (MocapError, ValueError, TypeError, IndexError, OverflowError) as error:
        raise _no_result(path) from error


def _folder_of_run(out: Path) -> Path:
    """The folder itself. Raises MocapError when it is not there: a lock cannot be kept in it then."""
    if not out.is_dir():
        raise _no_result(out / "run.json")
    return out


def _no_result(path: Path) -> MocapError:
    is_session = (path.parent / "session.toml").is_file()
    return MocapError(
        "the folder holds no result of a run",
        path=path,
        remedy="it is a session: give the output folder of its run, which comes before the session"
        if is_session
        else "run `mocap run SESSION -o OUT` first",
    )


def _check_not_joined(record: RunRecord, out: Path) -> None:
    if record.is_joined:
        raise MocapError(
            "the run was joined from pieces, and is edited in them",
            path=out,
            remedy="edit the pieces with `mocap edit PIECE`, apply it, and join them again",
        )


def _check_same(record: RunRecord, session: Session, out: Path) -> None:
    pairs = {
        "cameras": (record.cameras, session.rig.names),
        "frames": (record.frames, session.frames),
        "fps": (record.fps, session.fps),
    }
    for key, (ran, there) in pairs.items():
        if ran != there:
            raise MocapError(
                f"the session is not that of the run: {key} {there}, in the run {ran}",
                path=session.root,
                remedy=f"give the session that {out} was made from",
            )
