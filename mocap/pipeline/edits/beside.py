"""Edits in a run: read beside the result before the first stage."""

from __future__ import annotations

from pathlib import Path

from mocap.errors import MocapError
from mocap.io.session import Session
from mocap.pipeline.chains import WITH_VOLUMES, observation_kind
from mocap.pipeline.config import Config
from mocap.pipeline.edits.meaning import placed
from mocap.pipeline.edits.model import EDITS_FILE, Edits, edits_in


def with_edits(config: Config, out: Path, session: Session) -> Config:
    """The configuration with the edits that lie beside a result, pins placed in the world.

    session : with the cameras as they filmed. Raises MocapError for edits of a run that knows none.
    """
    found = edits_in(out)
    edits = config.edits if found is None else found
    if edits and observation_kind(session, config) not in WITH_VOLUMES:
        raise MocapError(
            "only runs on volumes can be edited, and this one finds poses from markers or keypoints alone",
            path=edits.file,
            remedy="take the file away, or correct detections or keypoints themselves",
        )
    return config.model_copy(update={"edits": placed(edits, session.rig, config.method.edits)})


def hand_words(edits: Edits) -> str:
    """What a result says of its edits."""
    n = len(edits.edit)
    return f"{n} edit{'s' * (n != 1)} by hand {'is' if n == 1 else 'are'} in this result ({EDITS_FILE})"
