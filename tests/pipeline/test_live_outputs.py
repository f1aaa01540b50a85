"""Live outputs: lines of JSON, OSC to the byte, datagrams on this machine."""

from __future__ import annotations

import io
import json
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mocap.body import load_body_model, scale_body
from mocap.data import LANDMARKS
from mocap.errors import MocapError
from mocap.pipeline.config import load_config
from mocap.pipeline.live.engine import FrameResult
from mocap.pipeline.live.outputs import (
    JsonLines,
    OnThread,
    UdpJson,
    UdpOsc,
    UdpVmc,
    osc_message,
    read_address,
)
from mocap.pipeline.live.persons import PersonResult
from mocap.pose.follow import FramePose

N = len(LANDMARKS)
PLACES = np.arange(3.0 * N).reshape(N, 3) / 7
POSE = FramePose(
    row=3, state=np.zeros(5), landmarks=PLACES, information=np.zeros((5, 5)), spread=np.zeros((N, 3, 3)),
    misfit=np.zeros(2), unexplained=0.0, blind_std=0.0, hidden_std=np.zeros(N), observed=np.arange(N) % 2 == 0,
    log_likelihood=-1.0, evidence=-2.0, ess_share=0.5, doubtful=np.zeros(N, dtype=bool),
)  # fmt: skip
BODY = scale_body(load_body_model(load_config().body_model("voxels")), 1.7654)
FOLLOWED = PersonResult(2, np.array([0.5, -0.25, 1.0]), 1.7654, BODY, POSE, np.linspace(0.01, 0.02, N))
RESULT = FrameResult(41, 12.34567, 0.0421, 6, (FOLLOWED, PersonResult(3, np.array([1.0, 2.0, 0.9]))))


def test_a_line_of_json_says_who_is_where() -> None:
    stream = io.StringIO()
    sink = JsonLines(stream, is_closed=False)
    sink.put(RESULT)
    sink.put(replace(RESULT, persons=()))
    sink.close()
    first, second = (json.loads(line) for line in stream.getvalue().splitlines())
    assert (first["frame"], first["time_s"], first["latency_ms"], first["n_cameras"]) == (
        41,
        12.3457,
        42.1,
        6,
    )
    followed, looked_at = first["persons"]
    assert (followed["person"], followed["height_m"], followed["xyz_m"]) == (2, 1.765, [0.5, -0.25, 1.0])
    assert list(followed["landmarks_m"]) == list(LANDMARKS)
    assert followed["landmarks_m"][LANDMARKS[4]] == np.round(PLACES[4], 4).tolist()
    assert followed["observed"][LANDMARKS[1]] is False
    assert followed["deviation_m"][LANDMARKS[-1]] == 0.02
    assert looked_at == {"person": 3, "xyz_m": [1.0, 2.0, 0.9], "height_m": None}
    assert second["persons"] == []
    assert first["things"] == []


def test_things_are_told_apart_from_persons() -> None:
    stream = io.StringIO()
    box = PersonResult(4, np.array([0.1, 0.2, 0.6]), is_thing=True)
    JsonLines(stream, is_closed=False).put(replace(RESULT, persons=(), things=(box,)))
    line = json.loads(stream.getvalue())
    assert line["persons"] == []
    assert line["things"] == [{"person": 4, "xyz_m": [0.1, 0.2, 0.6]}]


def test_what_is_not_known_is_null() -> None:
    unknown = replace(FOLLOWED, pose=replace(POSE, landmarks=np.full((N, 3), np.nan)))
    stream = io.StringIO()
    JsonLines(stream).put(replace(RESULT, persons=(unknown,)))
    (person,) = json.loads(stream.getvalue())["persons"]
    assert person["landmarks_m"][LANDMARKS[0]] == [None] * 3


def test_an_osc_message_to_the_byte() -> None:
    """OSC 1.0: strings end with zeros up to a multiple of four, numbers are big-endian."""
    assert osc_message("/ab", 1.0, -2.5) == b"/ab\0,ff\0" + bytes.fromhex("3f800000c0200000")
    assert osc_message("/abc") == b"/abc\0\0\0\0,\0\0\0"
    assert osc_message("/a", "bone", 7) == b"/a\0\0,si\0bone\0\0\0\0\0\0\0\x07"


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        own.settimeout(5.0)
        yield own


def test_datagrams_of_json_reach_this_machine(receiver: socket.socket) -> None:
    sink = UdpJson(read_address(str(receiver.getsockname()[1]), "--udp"))
    sink.put(RESULT)
    assert json.loads(receiver.recv(65536))["frame"] == 41
    sink.close()


def test_osc_sends_a_bundle_of_every_person_with_a_pose(receiver: socket.socket) -> None:
    sink = UdpOsc(receiver.getsockname())
    sink.put(RESULT)
    data = receiver.recv(65536)
    assert data[:16] == b"#bundle\0" + struct.pack(">Q", 1)
    messages = parts_of(data)
    assert len(messages) == N
    assert messages[2] == osc_message(f"/mocap/2/{LANDMARKS[2]}", *PLACES[2])
    receiver.settimeout(0.1)
    with pytest.raises(TimeoutError):
        receiver.recv(10)  # the person without a pose sends nothing
    sink.close()


def parts_of(bundle: bytes) -> list[bytes]:
    """The messages of an OSC bundle."""
    at, messages = 16, []
    while at < len(bundle):
        (size,) = struct.unpack_from(">i", bundle, at)
        messages.append(bundle[at + 4 : at + 4 + size])
        at += 4 + size
    return messages


def bones_of(receiver: socket.socket, state: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Bone -> place and quaternion that an avatar is told of a state."""
    sink = UdpVmc(receiver.getsockname())
    sink.put(replace(RESULT, persons=(replace(FOLLOWED, pose=replace(POSE, state=state)),)))
    sink.close()
    found = {}
    for message in parts_of(receiver.recv(65536)):
        if message.startswith(b"/VMC/Ext/Bone/Pos"):
            numbers = struct.unpack(">7f", message[-28:])
            name = message[32:-28].rstrip(b"\0").decode()
            found[name] = np.array(numbers[:3]), np.array(numbers[3:])
    return found


def test_an_avatar_in_a_t_pose_has_no_rotations(receiver: socket.socket) -> None:
    bones = bones_of(receiver, np.zeros(BODY.layout.n_columns))
    assert {"Hips", "Spine", "Neck", "LeftUpperArm", "LeftLowerArm", "RightUpperLeg", "RightLowerLeg"} <= set(
        bones
    )
    for _, quaternion in bones.values():
        np.testing.assert_allclose(quaternion, [0, 0, 0, 1], atol=1e-6)
    assert bones["LeftLowerArm"][0][0] < -0.2  # Unity's x is to the right
    assert bones["RightLowerLeg"][0][1] < -0.3


def test_an_avatar_turns_and_walks_as_the_person_does(receiver: socket.socket) -> None:
    """Forward is Unity's z, up is its y, and to turn left is a negative turn about it."""
    state = np.zeros(BODY.layout.n_columns)
    state[:3] = 2.0, 0.5, 0.9
    assert BODY.yaw_column is not None
    state[BODY.yaw_column] = np.pi / 2
    place, quaternion = bones_of(receiver, state)["Hips"]
    np.testing.assert_allclose(place, [-0.5, 0.9, 2.0], atol=1e-6)
    np.testing.assert_allclose(quaternion, [0, -np.sin(np.pi / 4), 0, np.cos(np.pi / 4)], atol=1e-6)


def test_an_avatar_stays_with_one_person(receiver: socket.socket) -> None:
    sink = UdpVmc(receiver.getsockname())
    still = replace(POSE, state=np.zeros(BODY.layout.n_columns))
    one, other = (replace(FOLLOWED, person=k, pose=still) for k in (4, 1))
    for persons, told in (((one,), 4), ((other, one), 4), ((other,), 1), ((), None)):
        sink.put(replace(RESULT, persons=persons))
        assert sink._person == told
    sink.close()


class Slow:
    """A sink that waits until it may go on."""

    def __init__(self) -> None:
        self.frames: list[int] = []
        self.may_go_on = threading.Event()

    def put(self, result: FrameResult) -> None:
        self.may_go_on.wait(10.0)
        self.frames.append(result.frame)
        if result.frame < 0:
            raise ValueError("no such frame")

    def close(self) -> None:
        self.frames.append(99)


def test_nobody_waits_for_a_sink_on_a_thread_and_it_gets_the_newest() -> None:
    slow = Slow()
    sink = OnThread(slow)
    sink.put(replace(RESULT, frame=1))
    wait_until(lambda: sink._newest is None)
    for frame in range(2, 50):
        sink.put(replace(RESULT, frame=frame))
    slow.may_go_on.set()
    sink.close()
    assert slow.frames == [1, 49, 99]


def test_what_a_sink_on_a_thread_raises_is_not_lost() -> None:
    slow = Slow()
    slow.may_go_on.set()
    sink = OnThread(slow)
    sink.put(replace(RESULT, frame=-1))
    wait_until(lambda: sink._error is not None)
    with pytest.raises(ValueError, match="no such frame"):
        sink.put(RESULT)
    sink.close()


def wait_until(is_so: Callable[[], bool]) -> None:
    until_s = time.monotonic() + 15.0
    while not is_so():
        assert time.monotonic() < until_s, "waited in vain"
        time.sleep(0.01)


def test_nobody_has_to_listen() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
        gone.bind(("127.0.0.1", 0))
        address = gone.getsockname()
    sink = UdpJson(address)
    for _ in range(3):
        sink.put(RESULT)
    sink.close()


def test_addresses() -> None:
    assert read_address("9000", "--udp") == ("127.0.0.1", 9000)
    assert read_address("192.168.0.7:39539", "--osc") == ("192.168.0.7", 39539)
    for wrong in ("", "host", "host:", "0", "70000", "a:b"):
        with pytest.raises(MocapError, match="--udp"):
            read_address(wrong, "--udp")
