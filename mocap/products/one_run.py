"""One run, one truth: whether store and tables in a folder are those of its run.json."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mocap.errors import MocapError
from mocap.io.store import StageStore

# Outputs that are read again: tables, poses and bodies.
_READ_AGAIN = (".csv", ".npz", ".toml")


def hashes_in(folder: Path) -> dict[str, str]:
    """File -> what it holds, of the outputs in a folder that are read again."""
    return {path.name: _hash(path) for path in sorted(folder.iterdir()) if path.suffix in _READ_AGAIN}


def _hash(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "blake2b").hexdigest()[:32]


def check_one_run(out: Path, *needed: str) -> None:
    """Raises MocapError when the store in `out` holds products of another run than its run.json, or lacks one, or when
    a table is not what that run has written.

    So it is after a run that was stopped between its first stage and its last file, and after a file was copied from
    elsewhere or damaged. A folder without run.json holds nothing that could be mixed up.
    needed : products that must be the run's own.
    """
    about = _about(out)
    if about is not None:
        _check_tables(out, about.get("file_hashes", {}))
    if not needed and not (out / "store.zarr").is_dir():
        return
    keys = None if about is None else {str(name): str(key) for name, key in about["product_keys"].items()}
    if keys is None and needed:
        raise MocapError(
            "the folder holds no result of a run",
            path=out,
            remedy="run `mocap run SESSION -o OUT` first, to its end",
        )
    if keys is not None:
        _check_products(out, keys, needed)


def _check_products(out: Path, keys: dict[str, str], needed: Sequence[str]) -> None:
    missing = [product for product in needed if product not in keys]
    if missing:
        raise MocapError(
            f"the run ended before there was a product {missing[0]}, or did not keep it",
            path=out,
            remedy="finish it with `mocap run SESSION -o OUT --resume --set output.keep=all`",
        )
    store = StageStore(out / "store.zarr")
    others = [product for product, key in keys.items() if not store.is_complete(product, key)]
    if others:
        raise MocapError(
            f"the store is not that of the tables beside it: {', '.join(others)} of the run in run.json is gone, "
            "because another run began in this folder and did not end",
            path=store.path,
            remedy="run `mocap run SESSION -o OUT --resume` to its end, with the settings that you want",
        )


def _check_tables(out: Path, hashes: Mapping[str, str]) -> None:
    changed = [
        name for name, known in hashes.items() if (out / name).is_file() and _hash(out / name) != known
    ]
    if changed:
        raise MocapError(
            f"{', '.join(changed)}: not what the run in run.json has written, but changed, damaged or of another run",
            path=out / changed[0],
            remedy="write it again with `mocap run SESSION -o OUT --resume`, or keep what you changed elsewhere",
        )


def _about(out: Path) -> dict[str, Any] | None:
    """What run.json says of products and files, None without a run."""
    try:
        about = json.loads((out / "run.json").read_text(encoding="utf-8"))
        return {
            "product_keys": dict(about["product_keys"]),
            "file_hashes": dict(about.get("file_hashes", {})),
        }
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise MocapError(
            "run.json does not say which products the run was made from",
            path=out / "run.json",
            remedy="run `mocap run SESSION -o OUT` again with this version",
        ) from error
