"""A recording in which a camera was pushed: every stretch that one calibration holds for is run, and they are joined.

`[calibration_from]` of session.toml says from which frame on another calibration holds; `mocap calibrate --refine
SESSION --moved CAM` writes it. A stretch goes on for two seconds into the next one, without the camera that was pushed
there: so much two runs must share for their persons to be known again.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from mocap.errors import MocapError
from mocap.io.session import Session, open_session
from mocap.pipeline.chains import WITH_VOLUMES, observation_kind
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.join import join_runs
from mocap.pipeline.record import OUTPUTS, RunResult
from mocap.pipeline.run import run_session
from mocap.progress import Progress

PIECES = "pieces"  # folder of their runs, in that of the whole
_SHARED_S = 2.0  # as `mocap batch --pieces` has it; `python -m eval.join_pieces` measures it
_SHARED_SHARE = 0.5  # at most, of a stretch


def run_recording(
    session: Path | str,
    out: Path | str,
    *,
    config: Config | None = None,
    seed: int = 0,
    until: str = OUTPUTS,
    resume: bool = False,
    rehash: bool = False,
    frames: tuple[int | None, int | None] | None = None,
    calibration: Path | str | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    command: str = "",
) -> RunResult:
    """`run_session`, stretch by stretch where one calibration does not hold for all frames.

    Runs of the stretches stay in OUT/pieces. Raises MocapError as `run_session` and `join_runs` do, and for a single
    stage, or a run without volumes, on more than one stretch.
    """
    opened = open_session(session, calibration=calibration, frames=frames)
    config = config or load_config()

    run = partial(
        run_session,
        config=config,
        seed=seed,
        resume=resume,
        rehash=rehash,
        n_threads=n_threads,
        progress=progress,
        command=command,
    )
    out = Path(out)
    if len(opened.stretches) == 1:
        return run(opened, out, until=until)
    _check_whole(opened, until, observation_kind(opened, config))
    pieces = [out / PIECES / f"{piece.start}-{piece.stop}" for piece in pieces_of(opened)]
    for path, piece in zip(pieces, pieces_of(opened), strict=True):
        run(session, path, until="pose", frames=(piece.start, piece.stop), calibration=calibration)
    return join_runs(Path(session), pieces, out, progress=progress, command=command)


def pieces_of(session: Session) -> list[range]:
    """The stretches of a session's frames, each with what it shares with the next one."""
    stretches = session.stretches
    shared = [min(round(_SHARED_S * session.fps), int(_SHARED_SHARE * len(late))) for late in stretches[1:]]
    return [range(s.start, s.stop + n) for s, n in zip(stretches, [*shared, 0], strict=True)]


def _check_whole(session: Session, until: str, kind: str) -> None:
    if until == OUTPUTS and kind in WITH_VOLUMES:
        return
    what = "a single stage works" if until != OUTPUTS else f"a run on {kind} works"
    parts = " or ".join(f"--frames {s.start}:{s.stop}" for s in session.stretches)
    frames = ", ".join(map(str, session.later_calibrations))
    raise MocapError(
        f"another calibration holds from frame {frames} on, and {what} with one",
        path=session.root / "session.toml",
        remedy=f"take one stretch, {parts}, or run the whole with `mocap run` on volumes",
    )
