"""Stages that walk together: a frame goes from hand to hand, and products are those of one stage after the other."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_session import PLAIN, small_session

from mocap.forks import can_fork, given, shared_zeros
from mocap.io.store import StageStore
from mocap.pipeline import run as run_module
from mocap.pipeline import walk
from mocap.pipeline.chains import CHAINS, stages_until
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.run import run_session
from mocap.pipeline.stage import ClipWork, Ending, FrameWork, Job, Row, Seen, Stage, StageReport, is_done
from mocap.pipeline.walk import run_together, walks
from mocap.profiling import profiled
from mocap.threads import Ahead

FRAMES = range(3, 15)
AGAIN = 100  # added by a second walk


def toy(
    name: str,
    *,
    reads: Any = None,
    walks: int = 1,
    needs_whole: tuple[str, ...] = (),
    log: Any = None,
    is_halved: bool = False,
) -> Stage:
    """Doubles the number that the mask of a frame holds; its state is the walk it is in and the sum so far.

    is_halved : the second half of a step, slower than the first, doubles it and knows the sum that the first left.
    """

    def step(state: tuple[int, int], seen: Seen) -> tuple[tuple[int, int], Seen, Sequence[Row]]:
        assert seen.masks is not None
        walk, total = state
        if log is not None:
            log(name, seen.frame)
        value = 2 * int(seen.masks[0][0]) + AGAIN * (walk - 1)
        total += value
        rows = [Row(name, seen.frame, {"x": np.array([value]), "total": np.array([total])})]
        return (walk, total), replace(seen, masks=[np.array([value])]), rows

    def first(state: tuple[int, int], seen: Seen) -> tuple[tuple[int, int], Seen, Sequence[Row]]:
        state, done, rows = step(state, seen)
        return state, replace(seen, begun=(done, rows)), ()

    def then(state: Any, seen: Seen) -> tuple[Seen, Sequence[Row]]:
        time.sleep(0.0005)
        done, rows = seen.begun
        return replace(done, begun="left over"), rows

    def finish(state: tuple[int, int]) -> Ending:
        return (
            Ending(again=(state[0] + 1, 0)) if state[0] < walks else Ending(attrs={name: {"walk": state[0]}})
        )

    work = FrameWork(
        reads or (lambda job: stored(job.store, name)),
        lambda job: (1, 0),
        first if is_halved else step,
        finish,
        ("masks",),
        then if is_halved else None,
    )
    return Stage(name, "pose", (name,), work, lambda job: StageReport(), needs_whole=needs_whole)


def clip(job: Job) -> Any:
    return {"masks": ((f, [np.array([f])]) for f in FRAMES)}


def stored(store: StageStore, name: str) -> Any:
    """What the stage before `name` has stored."""

    def rows() -> Iterator[tuple[int, Any]]:
        for frame, arrays in store.reader(chr(ord(name) - 1)):
            yield frame, [arrays["x"]]

    return {"masks": rows()}


def job(tmp_path: Path, key: str = "key", **more: Any) -> Job:
    session: Any = SimpleNamespace(frames=FRAMES)
    return Job(session, Config(), StageStore(tmp_path / "store.zarr"), key, **more)


def content(store: StageStore, product: str) -> Any:
    reader = store.reader(product)
    return reader.attrs, {f: {k: v.tolist() for k, v in sorted(arrays.items())} for f, arrays in reader}


@pytest.mark.parametrize("n_threads", [1, 2, 5])
@pytest.mark.parametrize("twice", ["", "a", "b", "c", "abc"])
@pytest.mark.parametrize("halved", ["", "a", "c", "abc"])
def test_together_is_one_after_the_other(tmp_path: Path, n_threads: int, twice: str, halved: str) -> None:
    def of(name: str, is_halved: bool) -> Stage:
        walks = 2 if name in twice else 1
        return toy(name, reads=clip if name == "a" else None, walks=walks, is_halved=is_halved)

    stages = [of(name, name in halved) for name in "abc"]
    together, alone = job(tmp_path / "1", n_threads=n_threads), job(tmp_path / "2")
    seconds = run_together([(stage, together) for stage in stages])
    for name in "abc":
        run_together([(of(name, False), alone)])
    assert list(seconds) == ["a", "b", "c"]
    for name in "abc":
        assert content(together.store, name) == content(alone.store, name)
        assert content(together.store, name)[0] == {"walk": 2 if name in twice else 1}


def two_halves(apart: tuple[str, ...] | None, die_at: int | None = None) -> Stage:
    """The first half doubles a mask and says which process it is; the second says whether that is its own, and which
    fields it is shown.  die_at : frame at which another process than this one is killed."""
    here = os.getpid()

    def step(state: int, seen: Seen) -> tuple[int, Seen, Sequence[Row]]:
        assert seen.masks is not None
        if seen.frame == die_at and os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return state, replace(seen, masks=[2 * seen.masks[0]], begun=os.getpid()), ()

    def then(state: int, seen: Seen) -> tuple[Seen, Sequence[Row]]:
        assert seen.masks is not None
        shown = [state, seen.begun == here, seen.pictures is not None]
        return seen, [Row("a", seen.frame, {"x": seen.masks[0].copy(), "shown": np.array(shown)})]

    def reads(job: Job) -> Any:
        pictures = ((f, [np.zeros((2, 3, 3), dtype=np.uint8)]) for f in FRAMES)
        return {"masks": ((f, [np.full((300, 400), f)]) for f in FRAMES), "pictures": pictures}

    work = FrameWork(reads, lambda job: 17, step, lambda state: Ending(), ("masks",), then, apart)
    return Stage("a", "pose", ("a",), work, lambda job: StageReport())


@pytest.mark.skipif(not can_fork(), reason="processes are forked on Linux alone")
@pytest.mark.parametrize("n_threads", [2, 3])
def test_a_first_half_in_another_process_finds_the_same(tmp_path: Path, n_threads: int) -> None:
    def shown(name: str, n_threads: int, apart: tuple[str, ...] | None, **more: Any) -> Any:
        own = job(tmp_path / name, n_threads=n_threads)
        run_together([(two_halves(apart, **more), own)])
        rows = dict(own.store.reader("a"))
        assert all(np.all(row["x"] == 2 * frame) for frame, row in rows.items())
        assert list(rows) == list(FRAMES)
        return {tuple(row["shown"]) for row in rows.values()}

    assert shown("in turn", 1, ("masks", "pictures")) == {(17, True, True)}
    assert shown("on threads", n_threads, None) == {(17, True, True)}
    assert shown("apart", n_threads, ("masks", "pictures")) == {(17, False, True)}
    assert shown("without pictures", n_threads, ("masks",)) == {(17, False, False)}
    # Killed, it is done again here, from the first frame.
    assert shown("killed", n_threads, ("masks", "pictures"), die_at=FRAMES[5]) == {(17, True, True)}


@pytest.mark.skipif(not can_fork(), reason="processes are forked on Linux alone")
def test_who_walks_forks_and_no_thread_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that a thread forks while a signal stops the walk is left by nobody, and waited for for ever."""
    forked_by = []

    def watched(*told: Any) -> Any:
        forked_by.append(threading.current_thread())
        return given(*told)

    monkeypatch.setattr(walk, "given", watched)
    later = FrameWork(lambda job: {}, lambda job: 0, lambda n, seen: (n, seen, ()), lambda n: Ending(), ())
    stages = [two_halves(("masks",)), Stage("b", "pose", (), later, lambda job: StageReport())]
    run_together([(stage, job(tmp_path, n_threads=3)) for stage in stages])
    assert forked_by == [threading.current_thread()]


@pytest.mark.skipif(not can_fork(), reason="processes are forked on Linux alone")
def test_a_profile_has_what_another_process_did(tmp_path: Path) -> None:
    with profiled() as profile:
        run_together([(two_halves(("masks",)), job(tmp_path, n_threads=2))])
    assert profile.n_calls == {("read",): len(FRAMES), ("a",): 2 * len(FRAMES)}


def finder(found: int, refutes_at: int | None) -> Stage:
    """Finds a number, known at the end, when 0 is nothing.  refutes_at : the frame from which on it says that others
    presume wrongly."""

    def step(state: int, seen: Seen) -> tuple[int, Seen, Sequence[Row]]:
        return state, replace(seen, is_refuted=refutes_at is not None and seen.frame >= refutes_at), ()

    def has_found_nothing(job: Job) -> bool:
        return dict(job.store.reader("a"))[0]["x"].tolist() == [0]

    rows = [Row("a", 0, {"x": np.array([found])})]
    work = FrameWork(clip, lambda job: 0, step, lambda state: Ending(rows))
    return Stage("a", "pose", ("a",), work, lambda job: StageReport(), found_nothing=has_found_nothing)


def presumer(log: list[tuple[str, int]], is_halved: bool) -> Stage:
    """Adds what the stage before has found to the number of the frame."""

    def start(job: Job) -> int:
        return 0 if "a" in job.presumed else int(dict(job.store.reader("a"))[0]["x"][0])

    def step(found: int, seen: Seen) -> tuple[int, Seen, Sequence[Row]]:
        log.append(("first", seen.frame))
        assert not seen.is_refuted
        value = [np.array([seen.frame + found])]
        rows = () if is_halved else [Row("b", seen.frame, {"x": value[0]})]
        return found, replace(seen, masks=value, begun=value), rows

    def then(found: int, seen: Seen) -> tuple[Seen, Sequence[Row]]:
        log.append(("second", seen.frame))
        return seen, [Row("b", seen.frame, {"x": seen.begun[0]})]

    work = FrameWork(clip, start, step, lambda found: Ending(), ("masks",), then if is_halved else None)
    return Stage("b", "pose", ("b",), work, lambda job: StageReport(), needs_whole=("a",))


@pytest.mark.parametrize("n_threads", [1, 2, 5])
@pytest.mark.parametrize("is_halved", [False, True])
@pytest.mark.parametrize(
    ("found", "refutes_at", "n_looked_at"),
    [
        (0, None, len(FRAMES)),
        (7, None, 2 * len(FRAMES)),
        (7, FRAMES[4], 4 + len(FRAMES)),
        (0, FRAMES[4], 4 + len(FRAMES)),
    ],
)
def test_who_presumes_that_nothing_is_found_walks_again_where_it_is_wrong(
    tmp_path: Path, n_threads: int, is_halved: bool, found: int, refutes_at: int | None, n_looked_at: int
) -> None:
    log: list[tuple[str, int]] = []
    said: list[tuple[str, int]] = []
    own = job(tmp_path, n_threads=n_threads, progress=lambda name, done, _: said.append((name, done)))
    stages = [finder(found, refutes_at), presumer(log, is_halved), toy("c")]
    assert list(walks(stages)) == [tuple(stages)]
    run_together([(stage, own) for stage in stages])
    assert [half for half, _ in log].count("first") == n_looked_at
    assert content(own.store, "b")[1] == {f: {"x": [f + found]} for f in FRAMES}
    # Who stands behind it walks with it.
    totals = np.cumsum([2 * (f + found) for f in FRAMES]).tolist()
    assert content(own.store, "c")[1] == {
        f: {"total": [t], "x": [2 * (f + found)]} for f, t in zip(FRAMES, totals, strict=True)
    }
    # What is passed on to another walk is no progress.
    assert [done for name, done in said if name == "b"].count(len(FRAMES) - 1) == (
        2 if n_looked_at == 2 * len(FRAMES) else 1
    )
    assert not list(own.store.path.glob(".*.partial"))


def test_a_product_is_in_place_before_a_later_stage_of_the_walk_ends(tmp_path: Path) -> None:
    """It may be asked for what is known at the end alone, and a later one that fails takes nothing away."""
    own = job(tmp_path)

    def fails(state: Any) -> Ending:
        assert content(own.store, "a")[0] == {"walk": 1}
        raise RuntimeError("a stage that ends badly")

    last = toy("b")
    assert isinstance(last.work, FrameWork)
    last = replace(last, work=replace(last.work, finish=fails))
    with pytest.raises(RuntimeError, match="ends badly"):
        run_together([(toy("a", reads=clip), own), (last, own)])
    assert is_done(toy("a"), own.store, "key")
    assert not is_done(last, own.store, "key")
    assert not list(own.store.path.glob(".*.partial"))


def test_what_is_found_is_not_read_from_the_store(tmp_path: Path) -> None:
    own = job(tmp_path)

    def unreadable(job: Job) -> Any:
        def rows() -> Iterator[tuple[int, Any]]:
            raise AssertionError("read from the store")
            yield

        return {"masks": rows()}

    run_together([(toy("a", reads=clip), own), (toy("b", reads=unreadable), own)])
    assert is_done(toy("b"), own.store, "key")


@pytest.mark.parametrize("n_threads", [1, 3])
def test_a_stage_that_fails_leaves_earlier_products(tmp_path: Path, n_threads: int) -> None:
    own = job(tmp_path)
    run_together([(toy("a", reads=clip), own), (toy("b"), own)])

    def fail(name: str, frame: int) -> None:
        if frame == FRAMES[5]:
            raise RuntimeError("a stage that fails")

    other = replace(own, key="other", n_threads=n_threads)
    with pytest.raises(RuntimeError, match="a stage that fails"):
        run_together([(toy("a", reads=clip), other), (toy("b", log=fail), other)])
    assert is_done(toy("a"), own.store, "key")
    assert is_done(toy("b"), own.store, "key")
    assert not list(own.store.path.glob(".*.partial"))
    assert not [t for t in threading.enumerate() if t.name == "mocap-ahead"]


@pytest.mark.parametrize("n_threads", [1, 3])
def test_a_stage_is_said_to_be_done_when_its_product_is_there(tmp_path: Path, n_threads: int) -> None:
    """Who is stopped reads which stages were finished and kept."""
    said: list[tuple[str, int, bool]] = []
    own = job(tmp_path, n_threads=n_threads)
    own = replace(own, progress=lambda n, done, _: said.append((n, done, own.store.is_complete(n, "key"))))
    run_together([(toy("a", reads=clip), own), (toy("b", walks=2), own)])
    for name in "ab":
        ends = [is_there for n, done, is_there in said if n == name and done == len(FRAMES)]
        assert ends == [True]
    assert not any(is_there for n, done, is_there in said if n == "b" and done < len(FRAMES))


def test_halves_of_a_step_are_at_work_side_by_side(tmp_path: Path) -> None:
    """The second half of a frame waits for the first half of a later one, which would never come otherwise."""
    begun = {frame: threading.Event() for frame in FRAMES}
    stage = toy("a", reads=clip, log=lambda name, frame: begun[frame].set(), is_halved=True)
    assert isinstance(stage.work, FrameWork)
    assert stage.work.then is not None
    then = stage.work.then

    def waits(state: Any, seen: Seen) -> tuple[Seen, Sequence[Row]]:
        assert seen.frame == FRAMES[-1] or begun[seen.frame + 1].wait(10.0)
        return then(state, seen)

    run_together([(replace(stage, work=replace(stage.work, then=waits)), job(tmp_path, n_threads=2))])


@pytest.mark.parametrize("n_threads", [1, 2])
def test_what_a_first_half_leaves_is_for_the_second_alone(tmp_path: Path, n_threads: int) -> None:
    """Nothing of it reaches the next stage, which would hold it, or take it for its own."""
    shown: list[Any] = []
    own, last = job(tmp_path, n_threads=n_threads), toy("b")
    assert isinstance(last.work, FrameWork)
    step = last.work.step

    def look(state: Any, seen: Seen) -> Any:
        shown.append(seen.begun)
        return step(state, seen)

    last = replace(last, work=replace(last.work, step=look))
    run_together([(toy("a", reads=clip, is_halved=True), own), (last, own)])
    assert shown == [None] * len(FRAMES)


def test_no_more_than_a_few_frames_are_held(tmp_path: Path) -> None:
    """However slow the last stage is, the first one waits for it."""
    reached = {"a": 0, "b": 0}
    furthest = 0

    def note(name: str, frame: int) -> None:
        nonlocal furthest
        reached[name] = frame
        if name == "b":
            furthest = max(furthest, reached["a"] - frame)
            time.sleep(0.01)

    own = job(tmp_path, n_threads=2)
    run_together([(toy("a", reads=clip, log=note), own), (toy("b", log=note), own)])
    assert 1 <= furthest <= 4


def test_stages_walk_together_until_one_needs_the_end_of_another() -> None:
    a, b = toy("a"), toy("b")
    c = toy("c", needs_whole=("b",))
    d = Stage("d", "pose", ("d",), ClipWork(lambda job: None), lambda job: StageReport())
    assert list(walks([a, b, c, d])) == [(a, b), (c,), (d,)]
    assert list(walks([a, c])) == [(a, c)]
    assert list(walks([])) == []
    names = [[stage.name for stage in together] for together in walks(CHAINS["voxels"])]
    assert names == [["segment", "occluders", "carve", "track"], ["pose"]]
    names = [[stage.name for stage in together] for together in walks(CHAINS["fused"])]
    assert names == [["keypoints"], ["segment", "occluders"], ["carve", "track"], ["pose"]]


def test_a_run_equals_its_stages_one_by_one(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    session = small_session(tmp_path_factory.getbasetemp())
    config = load_config("default", PLAIN)
    for out, n_threads, words in (
        ("once", 2, ("track",)),
        ("one_by_one", 1, ("segment", "occluders", "carve", "track")),
    ):
        for until in words:
            run_session(session, tmp_path / out, config=config, until=until, n_threads=n_threads, resume=True)
    stores = [StageStore(tmp_path / out / "store.zarr") for out in ("once", "one_by_one")]
    for stage in CHAINS["voxels"][:-1]:
        for product in stage.products:
            assert content(stores[0], product) == content(stores[1], product), product
            assert stores[0].reader(product).key == stores[1].reader(product).key


@pytest.mark.skipif(not can_fork(), reason="processes are forked on Linux alone")
@pytest.mark.parametrize("n_threads", [1, 2])
def test_stages_before_the_last_walk_report_beside_it(
    n_threads: int, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = small_session(tmp_path_factory.getbasetemp())
    is_told = shared_zeros((1,), np.bool_)

    def telling(stage: Stage) -> Stage:
        def report(job: Job) -> StageReport:
            is_told[0] = True
            return StageReport((f"{stage.name} by {os.getpid()}",))

        return replace(stage, report=report)

    def walked(stages: Sequence[tuple[Stage, Job]]) -> dict[str, float]:
        walls_s = run_together(stages)
        while n_threads > 1 and stages[0][0].name == "carve" and not is_told[0]:
            time.sleep(0.001)  # ends only if the others report meanwhile
        assert is_told[0] == (n_threads > 1 and stages[0][0].name == "carve")
        return walls_s

    stages = [telling(stage) for stage in stages_until("voxels", "track")]
    stages[1] = replace(stages[1], found_nothing=None)  # it is waited for: there are two walks
    monkeypatch.setattr(run_module, "stages_until", lambda kind, until: stages)
    monkeypatch.setattr(run_module, "run_together", walked)
    config = load_config("default", PLAIN)
    found = run_session(session, tmp_path / "out", config=config, until="track", n_threads=n_threads)
    by = dict(warning.split(" by ") for warning in found.record.warnings if " by " in warning)
    assert list(by) == ["segment", "occluders", "carve", "track"]
    assert by["carve"] == by["track"] == str(os.getpid())
    assert by["segment"] == by["occluders"]
    assert (by["segment"] == by["carve"]) == (n_threads == 1)


@pytest.mark.parametrize("lost", [("segment",), ("occluders",), ("segment", "carve"), ("segment", "track")])
def test_a_run_goes_on_from_whatever_products_a_kill_has_left(
    lost: Sequence[str], tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Products of stages that walk together are put in place one after the other."""
    session = small_session(tmp_path_factory.getbasetemp())
    config, out = load_config("default", PLAIN), tmp_path / "out"
    run_session(session, out, config=config, until="track", n_threads=1)
    store = StageStore(out / "store.zarr")
    stages = CHAINS["voxels"][:-1]
    before = {product: content(store, product) for stage in stages for product in stage.products}
    for product in (product for stage in stages if stage.name in lost for product in stage.products):
        store.remove(product)
    run_session(session, out, config=config, until="track", n_threads=1, resume=True)
    assert {product: content(store, product) for product in before} == before


def test_ahead_gives_items_in_order_and_errors_in_their_place() -> None:
    def items() -> Iterator[int]:
        yield from range(5)
        raise ValueError("at the end")

    got = []
    with Ahead(items(), 2) as ahead, pytest.raises(ValueError, match="at the end"):
        got.extend(ahead)
    assert got == [0, 1, 2, 3, 4]
    with Ahead(iter(range(5)), 2) as ahead:
        assert list(ahead) == [0, 1, 2, 3, 4]


def test_ahead_ends_when_nobody_takes_any_more() -> None:
    made = []

    def endless() -> Iterator[int]:
        while True:
            made.append(len(made))
            yield made[-1]

    with Ahead(endless(), 2) as ahead:
        assert next(ahead) == 0
    n = len(made)
    assert n <= 5
    time.sleep(0.1)
    assert len(made) == n
