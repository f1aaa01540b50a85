"""Views of a run, to judge it by: overlays, plots, a 3D scene and the report."""

from mocap.view.html import Figure
from mocap.view.overlay import (
    SIDE_COLOURS,
    BodyPart,
    contact_sheet,
    crop,
    draw_body,
    draw_floor_grid,
    draw_hull,
    draw_label,
    draw_mask,
    draw_skeleton,
    person_colour,
    person_window,
)
from mocap.view.places import draw_places
from mocap.view.plots import (
    plot_error_over_time,
    plot_landmark_errors,
)
from mocap.view.report import REPORT_SCORES, FramePanel, PersonPage, Place, ReportData, write_report
from mocap.view.scene import CodedPictures, SceneFrame, ScenePictures, write_rrd
from mocap.view.track_map import track_map_svg

__all__ = [
    "REPORT_SCORES",
    "SIDE_COLOURS",
    "BodyPart",
    "CodedPictures",
    "Figure",
    "FramePanel",
    "PersonPage",
    "Place",
    "ReportData",
    "SceneFrame",
    "ScenePictures",
    "contact_sheet",
    "crop",
    "draw_body",
    "draw_floor_grid",
    "draw_hull",
    "draw_label",
    "draw_mask",
    "draw_places",
    "draw_skeleton",
    "person_colour",
    "person_window",
    "plot_error_over_time",
    "plot_landmark_errors",
    "track_map_svg",
    "write_report",
    "write_rrd",
]
