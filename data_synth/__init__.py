"""Synthetic worlds with exact truth: `list_scenes`, `load_scene`, `synthesise`, `preview_sheet`, `scene_sheet`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from data_synth.preview import preview_sheet, scene_sheet
    from data_synth.scene import Scene, list_scenes, load_scene, synthesise

__all__ = ["Scene", "list_scenes", "load_scene", "preview_sheet", "scene_sheet", "synthesise"]

_HOME = {
    "Scene": "data_synth.scene",
    "list_scenes": "data_synth.scene",
    "load_scene": "data_synth.scene",
    "synthesise": "data_synth.scene",
    "preview_sheet": "data_synth.preview",
    "scene_sheet": "data_synth.preview",
}


def __getattr__(name: str) -> Any:
    # Lazy, so that `mocap --help` does not wait for pydantic and scipy.
    if name not in _HOME:
        raise AttributeError(f"module 'data_synth' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOME[name]), name)
