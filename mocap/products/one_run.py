"""One run, one truth: whether the products in a store are those that the tables beside it were made from."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from mocap.errors import MocapError
from mocap.io.store import StageStore


def check_one_run(out: Path, *needed: str) -> None:
    """Raises MocapError when the store in `out` holds products of another run than its run.json, or lacks one.

    So it is after a run that was stopped between its first stage and its last file. A folder without run.json or
    without a store holds nothing that could be mixed up.
    needed : products that must be the run's own.
    """
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
