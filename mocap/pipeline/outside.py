"""Results stay out of sessions: what lies there is taken for input by the next run."""

from __future__ import annotations

from pathlib import Path

from mocap.errors import MocapError

# What makes a folder a session: how its cameras stand, and what they saw.
_SETTINGS = ("session.toml", "calibration.*")
_SOURCES = ("videos", "images", "masks", "detections", "keypoints")


def check_outside(out: Path, *sessions: Path | str) -> None:
    """Raise MocapError when a file or folder for results is a session or lies in one, links followed.

    sessions : that the results are of; none = not known, then no folder above may look like one.
    """
    place = out.resolve()
    above = (place, *place.parents)
    roots = [Path(session).resolve() for session in sessions]
    if any(root in above for root in roots) or (not roots and any(map(_looks_like_a_session, above))):
        raise MocapError(
            "results do not belong into the session: they would be taken for its input",
            path=out,
            remedy="choose a place beside it with -o",
        )


def _looks_like_a_session(folder: Path) -> bool:
    """More is asked than of a folder that is to be run: a working folder may hold a calibration and nothing else."""
    return any(any(folder.glob(name)) for name in _SETTINGS) and any(
        (folder / name).is_dir() for name in _SOURCES
    )
