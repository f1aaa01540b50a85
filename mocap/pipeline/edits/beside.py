"""Edits in a run: read beside the result before the first stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap.data import Tracks
from mocap.io.session import Session
from mocap.io.store import StageStore
from mocap.pipeline.chains import WITH_VOLUMES
from mocap.pipeline.config import Config
from mocap.pipeline.edits.meaning import edited_tracks, placed
from mocap.pipeline.edits.model import EDITS_FILE, Edits, edits_in
from mocap.pipeline.stages.markers import wearer_tracks
from mocap.products.followed import things_in
from mocap.products.keypoints import stored_figure_tracks
from mocap.products.tracks import stored_tracks


def with_edits(config: Config, out: Path, session: Session) -> Config:
    """The configuration with the edits that lie beside a result, pins placed in the world.

    session : with the cameras as they filmed.
    """
    found = edits_in(out)
    edits = config.edits if found is None else found
    return config.model_copy(update={"edits": placed(edits, session.rig, config.method.edits)})


def tracks_before(store: StageStore, kind: str, frames: range, fps: float) -> Tracks:
    """The tracks of a run as they were before edits.  kind : of CHAINS.  frames : of the run."""
    if kind == "markers":
        return wearer_tracks(frames, fps)
    return stored_figure_tracks(store, fps) if kind == "keypoints" else stored_tracks(store, fps)


def tracks_after(store: StageStore, kind: str, session: Session, edits: Edits, *, has_poses: bool) -> Tracks:
    """The tracks of a run, called as the edits say; chains without volumes store them so.

    has_poses : of things that were tracked poses have told, and their tracks are left out.
    """
    if kind not in WITH_VOLUMES:
        return stored_tracks(store, session.fps)
    tracks = edited_tracks(store, session, edits)
    return tracks.rows(~np.isin(tracks.person, list(things_in(store)))) if has_poses else tracks


def hand_words(edits: Edits) -> str:
    """What a result says of its edits."""
    n = len(edits.edit)
    return f"{n} edit{'s' * (n != 1)} by hand {'is' if n == 1 else 'are'} in this result ({EDITS_FILE})"
