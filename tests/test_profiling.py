"""Where the time goes: parts of parts, several calls and threads, by a clock that the test turns."""

import threading

import pytest

from mocap import profiling
from mocap.profiling import part, profiled


class Clock:
    """Seconds that pass when somebody works."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        return self.now

    def work(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(profiling, "time", clock)
    return clock


def test_a_part_owns_what_is_not_in_parts_inside_it(clock: Clock) -> None:
    with profiled() as profile:
        for _ in range(2):
            with part("pose"):
                clock.work(1.0)
                with part("refine"):
                    clock.work(4.0)
                clock.work(0.5)
        with part("refine"):
            clock.work(0.25)
    assert profile.own_s == {("pose",): 3.0, ("pose", "refine"): 8.0, ("refine",): 0.25}
    assert profile.n_calls == {("pose",): 2, ("pose", "refine"): 2, ("refine",): 1}


def test_a_part_that_fails_is_measured_and_closed(clock: Clock) -> None:
    def fail() -> None:
        with part("pose"):
            clock.work(1.0)
            raise ValueError("no")

    with profiled() as profile:
        with pytest.raises(ValueError, match="no"):
            fail()
        with part("track"):
            clock.work(2.0)
    assert profile.own_s == {("pose",): 1.0, ("track",): 2.0}


def test_every_thread_has_parts_of_its_own(clock: Clock) -> None:
    def prepare() -> None:
        with part("prepare"):
            clock.work(3.0)

    with profiled() as profile, part("pose"):
        thread = threading.Thread(target=prepare)
        thread.start()
        thread.join()
    assert set(profile.own_s) == {("pose",), ("prepare",)}


def test_nothing_is_measured_when_nobody_listens(clock: Clock) -> None:
    with profiled() as profile:
        pass
    with part("pose"):
        clock.work(1.0)
    assert profile.own_s == {}


def test_the_table_has_the_longest_part_first_and_its_parts_below_it(clock: Clock) -> None:
    with profiled() as profile:
        for name, inside in (("carve", ()), ("pose", (("judge", 1.0), ("refine", 2.0)))):
            with part(name):
                clock.work(0.5)
                for inner, seconds in inside:
                    with part(inner):
                        clock.work(seconds)
    rows = [line.split() for line in profile.lines(n_frames=10)[1:]]
    assert [row[0] for row in rows] == ["pose", "refine", "judge", "carve"]
    assert rows[0][1:] == ["1", "3.50", "0.50", "350.0"]
