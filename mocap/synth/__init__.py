"""Synthetic sessions with exact truth: people, rooms, cameras, pictures, markers, faults."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mocap.synth.preview import preview_sheet, scene_sheet
    from mocap.synth.scene import Scene, list_scenes, load_scene
    from mocap.synth.session import synthesise

__all__ = ["Scene", "list_scenes", "load_scene", "preview_sheet", "scene_sheet", "synthesise"]

_HOME = {
    "Scene": "mocap.synth.scene",
    "list_scenes": "mocap.synth.scene",
    "load_scene": "mocap.synth.scene",
    "synthesise": "mocap.synth.session",
    "preview_sheet": "mocap.synth.preview",
    "scene_sheet": "mocap.synth.preview",
}


def __getattr__(name: str) -> Any:
    # Lazy, so that `mocap --help` does not wait for pydantic and scipy.
    if name not in _HOME:
        raise AttributeError(f"module 'mocap.synth' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOME[name]), name)
