"""Keys: a product is valid for one, the hash of everything that decides it."""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path

from mocap.io.session import Session
from mocap.pipeline.chains import CHAINS
from mocap.pipeline.config import Config, config_hash
from mocap.pipeline.stages.detect import marker_inputs


def stage_keys(session: Session, config: Config, seed: int, kind: str = "voxels") -> dict[str, str]:
    """The key of every stage: a hash of its configuration, its inputs, the code and the stages that it needs.

    kind : `markers` or `voxels`, which have stages of their own.
    """
    inputs = _fingerprint_inputs(session)
    named = _fingerprint_named_files(config)
    keys: dict[str, str] = {}
    for stage in CHAINS[kind]:
        keys[stage.name] = config_hash(
            stage.name,
            code_hash(),
            inputs,
            *(keys[name] for name in stage.needs),
            *(getattr(config, section) for section in stage.sections),
            *(str(getattr(session, fact)) for fact in stage.facts),
            named if "body" in stage.sections else "",
            seed if stage.is_random(config) else 0,
        )
    return keys


@cache
def code_hash() -> str:
    """Hash of the package's own source files: a product made by other code is not reused."""
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.toml")]):
        digest.update(path.relative_to(root).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _fingerprint_inputs(session: Session) -> str:
    """Hash of frame range, calibration and source files (size and first and last 64 kB of each)."""
    digest = hashlib.sha256()
    digest.update(repr((session.frames.start, session.frames.stop, session.rig.names)).encode())
    for camera in session.rig:
        for array in (camera.K, camera.dist, camera.R, camera.t):
            digest.update(array.tobytes())
    digest.update(repr((session.fps, sorted(session.roi_px.items()))).encode())
    marker_files = {path.name: path for path in marker_inputs(session)}
    masks = (session.mask_sources, session.roi_sources)
    for kind in (session.image_sources, session.background_sources, *masks, marker_files):
        for name in sorted(kind):
            source = kind[name]
            files = sorted(p for p in source.rglob("*") if p.is_file()) if source.is_dir() else [source]
            for file in files:
                size = file.stat().st_size
                digest.update(f"{name} {file.name} {size}".encode())
                with file.open("rb") as stream:
                    digest.update(stream.read(65536))
                    if size > 131072:
                        stream.seek(-65536, os.SEEK_END)
                        digest.update(stream.read())
    return digest.hexdigest()[:16]


def _fingerprint_named_files(config: Config) -> str:
    """Hash of the user's files that the configuration names; those that come with the package are in `code_hash`."""
    digest = hashlib.sha256()
    for name in (config.body.model, config.body.marker_set, config.pose.hierarchy, config.pose.limbs):
        path = Path(name)
        digest.update(f"{name} ".encode())
        if path.is_file():
            content = path.read_bytes()
            digest.update(f"{len(content)} ".encode() + content)
    return digest.hexdigest()[:16]
