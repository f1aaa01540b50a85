"""Outputs of a live run: JSON lines to a file, a pipe or by UDP, OSC and VMC by UDP; to this machine by default."""

from __future__ import annotations

import json
import math
import socket
import struct
import threading
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import IO, Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from mocap.body import skeleton_of
from mocap.data import landmark_names
from mocap.errors import MocapError
from mocap.io.formats.bone_names import renamed
from mocap.pipeline.live.engine import FrameResult
from mocap.pipeline.live.persons import PersonResult

_LOOPBACK = "127.0.0.1"
_MOST_S = 3.0  # that an output which hangs is waited for at the end
_TO_UNITY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""From our axes, x forward, y left, z up, to Unity's."""


class Sink(Protocol):
    """Somebody who wants every result."""

    def put(self, result: FrameResult) -> None: ...

    def close(self) -> None: ...


def result_to_json(result: FrameResult) -> dict[str, Any]:
    """A result as one line of JSON: metres, z up; a person without landmarks is being looked at."""
    return {
        "frame": result.frame,
        "time_s": round(result.time_s, 4),
        "latency_ms": round(1000 * result.latency_s, 1),
        "n_cameras": result.n_cameras,
        "persons": [_person_to_json(person) for person in result.persons],
        "things": [{"person": one.person, "xyz_m": _rounded(one.xyz)} for one in result.things],
    }


def _person_to_json(person: PersonResult) -> dict[str, Any]:
    about: dict[str, Any] = {"person": person.person, "xyz_m": _rounded(person.xyz), "height_m": None}
    if person.height_m is not None:
        about["height_m"] = round(person.height_m, 3)
    if person.pose is None or person.deviation_m is None:
        return about
    names = landmark_names(len(person.pose.landmarks))
    about["landmarks_m"] = {n: _rounded(xyz) for n, xyz in zip(names, person.pose.landmarks, strict=True)}
    about["deviation_m"] = dict(zip(names, _rounded(person.deviation_m), strict=True))
    about["observed"] = dict(zip(names, person.pose.observed.tolist(), strict=True))
    return about


def _rounded(values: Iterable[float]) -> list[float | None]:
    """Tenths of millimetres; None for what is not known, which JSON has no number for."""
    return [round(float(v), 4) if math.isfinite(v) else None for v in values]


class OnThread:
    """A sink on a thread of its own that gets the newest result: nobody waits for it."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._newest: FrameResult | None = None
        self._has_news = threading.Condition()
        self._is_over = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._work, name="mocap-live-output", daemon=True)
        self._thread.start()

    def put(self, result: FrameResult) -> None:
        if self._error is not None:
            raise self._error
        with self._has_news:
            self._newest = result
            self._has_news.notify()

    def close(self) -> None:
        with self._has_news:
            self._is_over = True
            self._has_news.notify()
        self._thread.join(_MOST_S)
        self._sink.close()

    def _work(self) -> None:
        while True:
            with self._has_news:
                self._has_news.wait_for(lambda: self._newest is not None or self._is_over)
                result, self._newest = self._newest, None
            if result is None:
                return
            try:
                self._sink.put(result)
            except Exception as error:
                # Not swallowed: whoever brings the next result raises it.
                self._error = error
                return


class JsonLines:
    """A line of JSON per result, into a text stream."""

    def __init__(self, stream: IO[str], *, is_closed: bool = True) -> None:
        self._stream, self._is_closed = stream, is_closed

    def put(self, result: FrameResult) -> None:
        self._stream.write(json.dumps(result_to_json(result)) + "\n")
        self._stream.flush()

    def close(self) -> None:
        if self._is_closed:
            self._stream.close()


class _Udp:
    """Datagrams to one address; what nobody receives is lost."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._address = address

    def send(self, data: bytes) -> None:
        with suppress(ConnectionError):  # nobody listens just now
            self._socket.sendto(data, self._address)

    def close(self) -> None:
        self._socket.close()


class UdpJson(_Udp):
    """A datagram of JSON per result."""

    def put(self, result: FrameResult) -> None:
        self.send(json.dumps(result_to_json(result)).encode())


class UdpOsc(_Udp):
    """A bundle of OSC messages per person: /mocap/PERSON/LANDMARK x y z, metres, z up."""

    def put(self, result: FrameResult) -> None:
        for person in result.persons:
            if person.pose is not None:
                self.send(
                    osc_bundle(
                        osc_message(f"/mocap/{person.person}/{name}", *xyz.tolist())
                        for name, xyz in zip(
                            landmark_names(len(person.pose.landmarks)), person.pose.landmarks, strict=True
                        )
                    )
                )


class UdpVmc(_Udp):
    """The Virtual Motion Capture protocol: one person's bones as local rotations, for avatars with a T pose at rest.

    The person who has been followed for longest. Unity's axes: x right, y up, z forward, left-handed.
    """

    def __init__(self, address: tuple[str, int]) -> None:
        super().__init__(address)
        self._person: int | None = None

    def put(self, result: FrameResult) -> None:
        followed = {p.person: p for p in result.persons if p.pose is not None and p.body is not None}
        if self._person not in followed:
            self._person = next(iter(followed), None)
        if self._person is not None:
            self.send(osc_bundle(_vmc_messages(followed[self._person], result.time_s)))


def _vmc_messages(person: PersonResult, time_s: float) -> Iterator[bytes]:
    assert person.pose is not None
    assert person.body is not None
    skeleton = renamed(skeleton_of(person.body, person.pose.state[None], person.person), "vrm")
    # A rotation of a left-handed frame has the quaternion of its matrix, as one of a right-handed frame.
    turned = _TO_UNITY @ skeleton.rotations[0] @ _TO_UNITY.T
    quaternions = Rotation.from_matrix(turned).as_quat(canonical=True)
    places = (
        np.where((skeleton.parents < 0)[:, None], skeleton.root_position[0], skeleton.offsets) @ _TO_UNITY.T
    )
    yield osc_message("/VMC/Ext/OK", 1)
    yield osc_message("/VMC/Ext/T", time_s)
    yield osc_message("/VMC/Ext/Root/Pos", "root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    for name, place, quaternion in zip(skeleton.names, places, quaternions, strict=True):
        bone = name[0].upper() + name[1:]  # as Unity writes what VRM calls upperArm
        yield osc_message("/VMC/Ext/Bone/Pos", bone, *place.tolist(), *quaternion.tolist())


def osc_message(address: str, *values: str | int | float) -> bytes:
    """An OSC 1.0 message of strings, 32-bit integers and floats."""
    tags = "".join("s" if isinstance(v, str) else "i" if isinstance(v, int) else "f" for v in values)
    coded = [
        _padded(v) if isinstance(v, str) else struct.pack(f">{t}", v)
        for t, v in zip(tags, values, strict=True)
    ]
    return b"".join([_padded(address), _padded("," + tags), *coded])


def osc_bundle(messages: Iterable[bytes]) -> bytes:
    """An OSC 1.0 bundle to be acted on at once."""
    return b"".join([b"#bundle\0", struct.pack(">Q", 1), *(struct.pack(">i", len(m)) + m for m in messages)])


def _padded(text: str) -> bytes:
    """A string of OSC: ended by zeros up to a multiple of four."""
    data = text.encode("ascii")
    return data + b"\0" * (4 - len(data) % 4)


def read_address(text: str, option: str) -> tuple[str, int]:
    """HOST:PORT, or PORT on this machine. Raises MocapError."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 2**16:
        raise MocapError(
            f"{option} is {text!r}", remedy=f"write {option} PORT for this machine, or HOST:PORT"
        )
    return host or _LOOPBACK, int(port)
