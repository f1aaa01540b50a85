"""Keys: a stage's products are valid for one, the hash of everything that decides them."""

from __future__ import annotations

import hashlib
from pathlib import Path

from pydantic import BaseModel

from mocap.io.session import Session
from mocap.pipeline.chains import CHAINS
from mocap.pipeline.config import Config, config_hash, named_files
from mocap.pipeline.inputs import FileHashes, input_hash
from mocap.pipeline.reach import code_hash_of
from mocap.pipeline.stage import Stage


def stage_keys(
    session: Session, config: Config, seed: int, kind: str = "voxels", hashes: FileHashes | None = None
) -> dict[str, str]:
    """The key of every stage: a hash of its code, its inputs, its settings and the stages that it needs.

    What a stage declares is what it is shown (`run_together`), so that no setting decides a result without being here.
    kind : `markers` or `voxels`, which have stages of their own.  hashes : of files, None = all are read.
    """
    inputs = input_hash(session, hashes or FileHashes())
    keys: dict[str, str] = {}
    for stage in CHAINS[kind]:
        keys[stage.name] = config_hash(
            stage.name,
            code_hash_of(stage.module),
            "" if stage.needs else inputs,
            *(keys[name] for name in stage.needs),
            *_settings(stage, config),
            *(f"{fact} {getattr(session, fact)!r}" for fact in stage.facts),
            seed if stage.is_random(config) else 0,
        )
    return keys


def _settings(stage: Stage, config: Config) -> list[BaseModel | str]:
    """The sections of a stage, and the content of the user's files that they name.

    Those that come with the package are in the hash of the code.
    """
    values: list[BaseModel | str] = []
    for name in stage.sections:
        section = getattr(config, name)
        values.append(section)
        values += [_file_content(Path(file)) for file in named_files(section)]
    return values


def _file_content(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
