"""Shell completion of values: names that the program knows, asked for when somebody presses the tabulator.

Names come from where they are defined; heavy modules are imported when a value is completed, not before.
"""

from __future__ import annotations

from collections.abc import Iterable


def _beginning(known: Iterable[str], typed: str) -> list[str]:
    return [name for name in known if name.startswith(typed)]


def presets(incomplete: str) -> list[str]:
    """Presets that come with the package."""
    from mocap.pipeline.config import presets as known

    return _beginning(known(), incomplete)


def settings(incomplete: str) -> list[str]:
    """Keys of --set, `section.key=`, and after the sign the words that a setting may be."""
    from mocap.pipeline.config import setting_keys, setting_words

    key, sign, value = incomplete.partition("=")
    if not sign:
        return [f"{name}=" for name in _beginning(setting_keys(), incomplete)]
    # A list is completed at its last item.
    before, comma, last = value.rpartition(",")
    return [f"{key}={before}{comma}{word}" for word in _beginning(setting_words(key), last)]


def filters(incomplete: str) -> list[str]:
    """Pose filters."""
    from mocap.filters import FILTERS

    return _beginning(FILTERS, incomplete)


def observations(incomplete: str) -> list[str]:
    """What poses may be found from."""
    from mocap.pipeline.config import OBSERVATIONS

    return _beginning(OBSERVATIONS, incomplete)


def devices(incomplete: str) -> list[str]:
    """What may score particles."""
    from mocap.pipeline.config import setting_words

    return _beginning(setting_words("likelihood.device"), incomplete)


def stages(incomplete: str) -> list[str]:
    """The words of --until."""
    from mocap.pipeline.chains import UNTIL

    return _beginning(UNTIL, incomplete)


def scenes(incomplete: str) -> list[str]:
    """Scenes that come with the package."""
    from mocap.synth.scene import list_scenes

    return _beginning(list_scenes(), incomplete)


def edits(incomplete: str) -> list[str]:
    """What may be edited."""
    from mocap.pipeline.edits.model import KINDS

    return _beginning(KINDS, incomplete)


def landmarks(incomplete: str) -> list[str]:
    """Landmarks that may be pinned."""
    from mocap.pipeline.edits.model import LANDMARKS

    return _beginning(LANDMARKS, incomplete)
