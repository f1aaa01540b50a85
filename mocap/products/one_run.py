"""One run, one truth: whether store and tables in a folder are those of its run.json."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

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
    _check_tables(out)
    if not needed and not (out / "store.zarr").is_dir():
        return
    keys = _product_keys(out)
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


def _check_tables(out: Path) -> None:
    try:
        hashes: Mapping[str, str] = dict(
            json.loads((out / "run.json").read_text(encoding="utf-8"))["file_hashes"]
        )
    except (OSError, ValueError, KeyError, TypeError):
        return  # no run, or one of a version that did not note them
    changed = [
        name for name, known in hashes.items() if (out / name).is_file() and _hash(out / name) != known
    ]
    if changed:
        raise MocapError(
            f"{', '.join(changed)}: not what the run in run.json has written, but changed, damaged or of another run",
            path=out / changed[0],
            remedy="write it again with `mocap run SESSION -o OUT --resume`, or keep what you changed elsewhere",
        )


def _product_keys(out: Path) -> dict[str, str] | None:
    """Product -> key that the run was made from, None without a run."""
    try:
        about = json.loads((out / "run.json").read_text(encoding="utf-8"))
        return {str(product): str(key) for product, key in about["product_keys"].items()}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise MocapError(
            "run.json does not say which products the run was made from",
            path=out / "run.json",
            remedy="run `mocap run SESSION -o OUT` again with this version",
        ) from error
