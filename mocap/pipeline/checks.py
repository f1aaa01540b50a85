"""What is checked before the first stage: names that only the code knows, and whether the output can be written."""

from __future__ import annotations

from pathlib import Path

from mocap.body import load_body_model, scale_body
from mocap.body.markers import load_marker_set, place_markers
from mocap.errors import MocapError
from mocap.pipeline.config import Config
from mocap.pipeline.pose_settings import check_filter


def check_config(config: Config, kind: str) -> None:
    """Filter, likelihood, body and marker set against each other. Raises MocapError."""
    check_filter(config.pose, "likelihood", factorised=config.likelihood.factorised)
    load_body_model(config.body_model("voxels"))
    if kind == "markers":
        _check_markers(config)


def _check_markers(config: Config) -> None:
    """The marker set against the body, and the filter against the likelihood."""
    body = scale_body(load_body_model(config.body_model("markers")), 1.0)
    place_markers(load_marker_set(config.body.marker_set), body)
    check_filter(config.pose, "markers", factorised=config.markers.factorised)


def check_writable(out: Path) -> None:
    """Make the output folder. Raises MocapError when nothing can be written there."""
    probe = out / ".mocap-write-test"
    try:
        out.mkdir(parents=True, exist_ok=True)
        try:
            probe.write_bytes(b"x")
        finally:
            probe.unlink(missing_ok=True)
    except OSError as error:
        raise MocapError(
            f"the output folder cannot be written: {error.strerror or error}",
            path=out,
            remedy="choose another folder with -o, or free space and check its permissions",
        ) from error
