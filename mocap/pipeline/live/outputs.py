"""Outputs of a live run: JSON lines to a file, a pipe or by UDP, and OSC by UDP; to this machine by default."""

from __future__ import annotations

import json
import math
import socket
import struct
from collections.abc import Iterable
from contextlib import suppress
from typing import IO, Any, Protocol

from mocap.data import LANDMARKS
from mocap.errors import MocapError
from mocap.pipeline.live.engine import FrameResult, PersonResult

_LOOPBACK = "127.0.0.1"


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
    }


def _person_to_json(person: PersonResult) -> dict[str, Any]:
    about: dict[str, Any] = {"person": person.person, "xyz_m": _rounded(person.xyz), "height_m": None}
    if person.height_m is not None:
        about["height_m"] = round(person.height_m, 3)
    if person.pose is None or person.deviation_m is None:
        return about
    about["landmarks_m"] = {n: _rounded(xyz) for n, xyz in zip(LANDMARKS, person.pose.landmarks, strict=True)}
    about["deviation_m"] = dict(zip(LANDMARKS, _rounded(person.deviation_m), strict=True))
    about["observed"] = dict(zip(LANDMARKS, person.pose.observed.tolist(), strict=True))
    return about


def _rounded(values: Iterable[float]) -> list[float | None]:
    """Tenths of millimetres; None for what is not known, which JSON has no number for."""
    return [round(float(v), 4) if math.isfinite(v) else None for v in values]


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
                        for name, xyz in zip(LANDMARKS, person.pose.landmarks, strict=True)
                    )
                )


def osc_message(address: str, *values: float) -> bytes:
    """An OSC 1.0 message of 32-bit floats."""
    return _padded(address) + _padded("," + "f" * len(values)) + struct.pack(f">{len(values)}f", *values)


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
