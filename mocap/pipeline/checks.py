"""Checks before the first stage: what would cost a computed run is looked at before it is computed."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from mocap.body import Body, build_look_up_table, load_body_model, scale_body
from mocap.body.initial import DEFAULT_HEIGHT_M
from mocap.body.markers import load_marker_set, place_markers
from mocap.errors import MissingExtra, MocapError
from mocap.forks import begun
from mocap.io.session import Session
from mocap.io.truth import read_true_voxels
from mocap.likelihood.voxels.device import device_name
from mocap.pipeline.config import Config
from mocap.pipeline.outside import check_outside
from mocap.pipeline.pose_settings import check_filter, stated_height_m
from mocap.pipeline.publish import check_replaceable
from mocap.pipeline.stages.carve import faulty_views, grid_of
from mocap.portable import total_memory_bytes

_BYTES_PER_GB = 1e9
# Where the machine does not tell.
_USUAL_MEMORY_BYTES = 16e9
# Arrays of states, all float64, that a filter holds at the same time: particles, noise, proposals and their transforms.
_STATES_AT_ONCE = 4
# Limbs of any grown-up hold points of this spacing; finer tables only take time to look at.
_FINE_M = 0.03
# A carver keeps a byte or more of every voxel: blocks, labels of components and the surface.
_BYTES_PER_VOXEL = 2


def check_config(config: Config, kind: str) -> None:
    """Filter, likelihood, body and marker set against each other, and particles against the memory.

    Raises MocapError.
    """
    check_filter(config.pose, "likelihood", factorised=config.likelihood.factorised)
    body = scale_body(load_body_model(config.body_model("voxels")), 1.0)
    if kind == "markers":
        body = scale_body(load_body_model(config.body_model("markers")), 1.0)
        place_markers(load_marker_set(config.body.marker_set), body)
        check_filter(config.pose, "markers", factorised=config.markers.factorised)
    _check_particles(config, body)


def _check_particles(config: Config, body: Body) -> None:
    n_particles = max(config.pose.n_particles, *config.pose.level_particles, 0)
    needed = 8.0 * _STATES_AT_ONCE * n_particles * len(body.layout.names)
    if needed > _memory_bytes():
        raise MocapError(
            f"configuration: pose: {n_particles} particles take {needed / _BYTES_PER_GB:.3g} GB or more, this machine "
            f"has {_memory_bytes() / _BYTES_PER_GB:.3g} GB",
            remedy="lower pose.n_particles or pose.level_particles; some hundred are usual",
        )


def check_device(config: Config) -> None:
    """What is to score particles is there. Raises MocapError."""
    if config.likelihood.device != "cuda":
        return
    # Asked elsewhere: a process that has opened a device forks no more.
    with begun(device_name, 2) as name:
        if name() is not None:
            return
    without = "let the processor score: --device cpu"
    if find_spec("numba_cuda") is None:
        raise MissingExtra("--device cuda needs the package numba-cuda", "gpu", otherwise=without)
    raise MocapError(
        "--device cuda: no CUDA device answers", remedy=f"see whether `nvidia-smi` lists one, or {without}"
    )


def check_volume(session: Session, config: Config) -> None:
    """The voxel grid, and how many cameras may be wrong. Raises MocapError."""
    grid = grid_of(session, config)
    needed = float(_BYTES_PER_VOXEL) * grid.n_voxels
    if needed > _memory_bytes():
        raise MocapError(
            f"the volume has {grid.n_voxels} voxels, which take {needed / _BYTES_PER_GB:.3g} GB or more; this machine "
            f"has {_memory_bytes() / _BYTES_PER_GB:.3g} GB",
            remedy="use larger voxels (volume.voxel_size_m) or a smaller room (room_bounds_m)",
        )
    n = len(session.rig)
    k = faulty_views(session, config)
    if k >= n:
        raise MocapError(
            f"configuration: volume.n_faulty_views is {k}, and the session has {n} cameras",
            remedy=f"let at most {max(0, n - 2)} cameras be wrong, or leave it `auto`",
        )


def check_flesh(session: Session, config: Config, kind: str) -> None:
    """Every part of the body holds a point of the table that voxels are compared with. Raises MocapError."""
    spacing_m = config.volume.voxel_size_m * config.pose.table_density
    if kind in ("markers", "keypoints") or spacing_m < _FINE_M:
        return
    model = load_body_model(config.body_model("voxels"))
    height_m = stated_height_m(config, model, session) or DEFAULT_HEIGHT_M
    try:
        build_look_up_table(scale_body(model, height_m), spacing_m)
    except ValueError as error:
        raise MocapError(
            f"configuration: the voxels are too large for the body: {error}",
            remedy="lower volume.voxel_size_m, or pose.table_density",
        ) from error


def _memory_bytes() -> float:
    return float(total_memory_bytes() or _USUAL_MEMORY_BYTES)


def check_truth(session: Session) -> None:
    """The truth that the result will be scored against can be read. Raises MocapError."""
    _ = session.true_motions, session.true_tracks
    if session.truth_dir is not None and (session.truth_dir / "voxels.npz").exists():
        read_true_voxels(session.truth_dir / "voxels.npz")


def check_out(out: Path, session: Session) -> None:
    """Make the output folder. Raises MocapError when it is part of the session, or cannot be written."""
    check_outside(out, session.root)
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
    check_replaceable(out)
