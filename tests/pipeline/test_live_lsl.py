"""Streams of the Lab Streaming Layer: a stand-in of the interface of pylsl, and pylsl itself where it is installed."""

from __future__ import annotations

import sys
import uuid
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_live_outputs import FOLLOWED, PLACES, RESULT, N

from mocap.data import LANDMARKS
from mocap.errors import MissingExtra
from mocap.pipeline.live.lsl import LslStreams
from mocap.pipeline.live.persons import MOST_PERSONS, PersonResult


class Node:
    """An element of a stream's description."""

    def __init__(self) -> None:
        self.children: list[tuple[str, Node]] = []
        self.values: dict[str, str] = {}

    def append_child(self, name: str) -> Node:
        self.children.append((name, Node()))
        return self.children[-1][1]

    def append_child_value(self, name: str, value: str) -> Node:
        self.values[name] = value
        return self


class Info:
    def __init__(self, *about: Any) -> None:
        self.about, self.root = about, Node()

    def desc(self) -> Node:
        return self.root


class Outlet:
    def __init__(self, info: Info) -> None:
        self.info, self.samples = info, []
        opened.append(self)

    def push_sample(self, values: list[float], time_s: float) -> None:
        assert len(values) == self.info.about[2]
        self.samples.append((values, time_s))


opened: list[Outlet] = []
STAND_IN = SimpleNamespace(
    StreamInfo=Info, StreamOutlet=Outlet, IRREGULAR_RATE=0.0, cf_float32=1, local_clock=lambda: 100.0
)


@pytest.fixture
def streams(monkeypatch: pytest.MonkeyPatch) -> LslStreams:
    opened.clear()
    monkeypatch.setitem(sys.modules, "pylsl", STAND_IN)
    return LslStreams("room")


def test_a_person_with_a_pose_has_a_stream(streams: LslStreams) -> None:
    streams.put(RESULT)
    streams.put(RESULT)
    (outlet,) = opened  # whoever is only looked at has none yet
    assert outlet.info.about == ("room-2", "MoCap", 4 * N, 0.0, 1, "room-2")
    (values, time_s), _ = outlet.samples
    assert time_s == 100.0 - RESULT.latency_s
    np.testing.assert_allclose(np.reshape(values, (N, 4))[:, :3], PLACES)
    np.testing.assert_allclose(np.reshape(values, (N, 4))[:, 3], FOLLOWED.deviation_m)


def test_channels_say_what_they_are(streams: LslStreams) -> None:
    streams.put(RESULT)
    ((name, channels),) = opened[0].info.root.children
    assert name == "channels"
    assert len(channels.children) == 4 * N
    assert channels.children[5][1].values == {
        "label": f"{LANDMARKS[1]}_PositionY", "marker": LANDMARKS[1], "type": "PositionY", "unit": "meters",
    }  # fmt: skip


def test_streams_are_no_more_than_persons_who_are_remembered(streams: LslStreams) -> None:
    def seen(person: int) -> PersonResult:
        return replace(FOLLOWED, person=person)

    for person in (*range(MOST_PERSONS), 0, MOST_PERSONS):
        streams.put(replace(RESULT, persons=(seen(person),)))
    assert list(streams._outlets) == [*range(2, MOST_PERSONS), 0, MOST_PERSONS]
    streams.close()
    assert not streams._outlets


def test_without_pylsl_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(MissingExtra, match=r"mocap-volumes\[lsl\]"):
        LslStreams("room")


def test_pylsl_itself_receives_the_landmarks() -> None:
    pylsl = pytest.importorskip("pylsl", reason="needs the extra lsl")
    name = f"mocap-{uuid.uuid4()}"
    streams = LslStreams(name)
    streams.put(RESULT)
    (found,) = pylsl.resolve_byprop("name", f"{name}-2", timeout=10.0)
    inlet = pylsl.StreamInlet(found)
    inlet.open_stream(10.0)
    before_s = pylsl.local_clock()
    streams.put(RESULT)
    values, time_s = inlet.pull_sample(10.0)
    np.testing.assert_allclose(np.reshape(values, (N, 4))[:, :3], PLACES, rtol=1e-6)
    assert before_s - RESULT.latency_s <= time_s <= pylsl.local_clock() - RESULT.latency_s
    assert inlet.info(10.0).get_channel_labels()[:2] == ["pelvis_PositionX", "pelvis_PositionY"]
    streams.close()
