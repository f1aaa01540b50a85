"""The loop around stages that work frame by frame: sources, rows that wait, a second walk, and what is left behind."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocap.io.store import StageStore
from mocap.pipeline.chains import CHAINS, UNTIL, stages_until
from mocap.pipeline.config import Config
from mocap.pipeline.stage import (
    ClipWork,
    Ending,
    FrameWork,
    Job,
    Row,
    Seen,
    Sources,
    Stage,
    StageReport,
)
from mocap.pipeline.walk import run_stage

FRAMES = range(3, 8)


@dataclass(frozen=True)
class State:
    """threads : `map`, as it was given.  walk : 1, 2.  late : the row that waits for the next frame."""

    each: Any
    walk: int = 1
    late: tuple[Row, ...] = ()


class Source:
    """Masks of the frames; knows whether it was opened and closed."""

    def __init__(self) -> None:
        self.log: list[str] = []

    def __enter__(self) -> Source:
        self.log.append("open")
        return self

    def __exit__(self, *_: object) -> None:
        self.log.append("closed")

    def __iter__(self) -> Iterator[tuple[int, list[np.ndarray]]]:
        for frame in FRAMES:
            yield frame, [np.full((2, 3), frame % 2 == 0)]


def row(product: str, frame: int, value: float) -> Row:
    return Row(product, frame, {"x": np.array([value])})


def stage(source: Source, *, walks: int = 1, fails_at: int | None = None) -> Stage:
    """Product `now` is written at once, `later` one frame late."""

    def reads(job: Job) -> Sources:
        return {"masks": source}  # type: ignore[dict-item]

    def step(state: State, seen: Seen) -> tuple[State, Seen, Sequence[Row]]:
        if seen.frame == fails_at:
            raise RuntimeError("a stage that fails")
        assert seen.masks is not None
        assert seen.frame == FRAMES[seen.index]
        (doubled,) = state.each(lambda f: 2.0 * f, [seen.frame])
        rows = [row("now", seen.frame, doubled + 100 * state.walk), *state.late]
        late = (row("later", seen.frame, float(seen.masks[0].mean())),)
        return replace(state, late=late), seen, rows

    def finish(state: State) -> Ending:
        if state.walk < walks:
            return Ending(again=State(state.each, state.walk + 1))
        return Ending(state.late, {"now": {"walk": state.walk}})

    work = FrameWork(reads, lambda job: State(job.each), step, finish)
    return Stage("toy", "pose", ("now", "later"), work, lambda job: StageReport())


def job(tmp_path: Path, **more: Any) -> Job:
    session: Any = SimpleNamespace(frames=FRAMES)
    return Job(session, Config(), StageStore(tmp_path / "store.zarr"), "key", **more)


def values(store: StageStore, product: str) -> dict[int, float]:
    return {frame: float(arrays["x"][0]) for frame, arrays in store.reader(product)}


@pytest.mark.parametrize("n_threads", [1, 3])
def test_every_frame_is_shown_in_order_and_rows_may_wait(tmp_path: Path, n_threads: int) -> None:
    said: list[tuple[str, int, int]] = []
    source = Source()
    own = job(tmp_path, n_threads=n_threads, progress=lambda *what: said.append(what))
    run_stage(stage(source), own)
    assert values(own.store, "now") == {f: 100 + 2.0 * f for f in FRAMES}
    assert values(own.store, "later") == {f: float(f % 2 == 0) for f in FRAMES}
    assert own.store.reader("now").attrs == {"walk": 1}
    assert own.store.reader("later").attrs == {}
    assert said == [("toy", i + 1, len(FRAMES)) for i in range(len(FRAMES))]
    assert source.log == ["open", "closed"]


def test_another_walk_takes_the_place_of_the_first(tmp_path: Path) -> None:
    source = Source()
    own = job(tmp_path)
    run_stage(stage(source, walks=2), own)
    assert values(own.store, "now") == {f: 200 + 2.0 * f for f in FRAMES}
    assert set(values(own.store, "later")) == set(FRAMES)
    assert own.store.reader("now").attrs == {"walk": 2}
    assert source.log == ["open", "closed"] * 2


@pytest.mark.parametrize("fails_at", [FRAMES[0], FRAMES[2], FRAMES[-1]])
def test_a_stage_that_fails_leaves_the_earlier_products(tmp_path: Path, fails_at: int) -> None:
    own = job(tmp_path)
    run_stage(stage(Source()), own)
    before = values(own.store, "now")
    source = Source()
    with pytest.raises(RuntimeError):
        run_stage(stage(source, walks=2, fails_at=fails_at), replace(own, key="other"))
    assert values(own.store, "now") == before
    assert own.store.is_complete("now", "key")
    assert own.store.is_complete("later", "key")
    assert not list(own.store.path.glob(".*.partial"))
    assert source.log == ["open", "closed"]


def test_work_on_the_whole_clip_writes_its_own_products(tmp_path: Path) -> None:
    def work(own: Job) -> None:
        with own.writer("now", {"a": 1}) as out:
            out.append(5, x=np.ones(1))

    own = job(tmp_path)
    run_stage(Stage("clip", "pose", ("now",), ClipWork(work), lambda j: StageReport()), own)
    assert values(own.store, "now") == {5: 1.0}
    assert own.store.is_complete("now", "key")


@pytest.mark.parametrize("kind", CHAINS)
def test_a_chain_is_in_order_and_complete(kind: str) -> None:
    """What a stage needs comes before it, no product has two writers, and each has a word that ends a run after it."""
    names: list[str] = []
    products: list[str] = []
    for stage_ in CHAINS[kind]:
        assert set(stage_.needs) <= set(names)
        assert set(stage_.sections) <= set(Config.model_fields)
        names.append(stage_.name)
        products += stage_.products
    assert len(set(products)) == len(products)
    assert len(set(names)) == len(names)
    lengths = [len(stages_until(kind, word)) for word in UNTIL]
    assert lengths == sorted(lengths)
    assert stages_until(kind, "report") == CHAINS[kind]
    assert lengths[0] >= 1
