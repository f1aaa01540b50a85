"""Lab Streaming Layer: landmarks beside EMG and EEG on one clock; pylsl is an optional extra (`lsl`).

A stream of the type MoCap per person, since the channels of a stream are fixed, with a sample per result that has a
pose. LSL itself offers streams to the local network; its own lsl_api.cfg says how far.
Source: channels as in the MoCap meta-data of XDF (labels, type, unit).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import landmark_names
from mocap.errors import MissingExtra
from mocap.pipeline.live.engine import FrameResult
from mocap.pipeline.live.persons import MOST_PERSONS

_TYPES = ("PositionX", "PositionY", "PositionZ", "StandardDeviation")


class LslStreams:
    """Streams NAME-PERSON: x, y, z and the standard deviation along an axis of each landmark, m, world, z up.

    A sample's time is that of the pictures by LSL's clock. Raises MissingExtra without pylsl.
    """

    def __init__(self, name: str) -> None:
        try:
            import pylsl
        except ImportError as error:
            raise MissingExtra(
                "streams of LSL need pylsl, which is not installed", "lsl", otherwise="leave --lsl out"
            ) from error
        self._lsl, self._name = pylsl, name
        self._outlets: dict[int, Any] = {}

    def put(self, result: FrameResult) -> None:
        time_s = self._lsl.local_clock() - result.latency_s
        for person in result.persons:
            if person.pose is not None and person.deviation_m is not None:
                values = np.column_stack([person.pose.landmarks, person.deviation_m])
                self._outlet(person.person, len(values)).push_sample(_flat(values), time_s)

    def close(self) -> None:
        self._outlets.clear()  # an outlet that is let go of is taken off the network

    def _outlet(self, person: int, n_landmarks: int) -> Any:
        """A person's stream; whoever was seen last stands last, and the first gives way to one too many."""
        outlet = self._outlets.pop(person, None) or self._opened(person, n_landmarks)
        self._outlets[person] = outlet
        while len(self._outlets) > MOST_PERSONS:
            del self._outlets[next(iter(self._outlets))]
        return outlet

    def _opened(self, person: int, n_landmarks: int) -> Any:
        lsl, name = self._lsl, f"{self._name}-{person}"
        info = lsl.StreamInfo(
            name, "MoCap", len(_TYPES) * n_landmarks, lsl.IRREGULAR_RATE, lsl.cf_float32, name
        )
        channels = info.desc().append_child("channels")
        for landmark in landmark_names(n_landmarks):
            for kind in _TYPES:
                channel = channels.append_child("channel")
                channel.append_child_value("label", f"{landmark}_{kind}")
                channel.append_child_value("marker", landmark)
                channel.append_child_value("type", kind)
                channel.append_child_value("unit", "meters")
        return lsl.StreamOutlet(info)


def _flat(values: NDArray[np.float64]) -> list[float]:
    """(M, 4) as the channels in order."""
    flat: list[float] = values.ravel().tolist()
    return flat
