"""A session folder: its settings, its sources, its frames, and the rules that open and check it."""

from mocap.io.session.record import Finding, Session
from mocap.io.session.rules import OpenedClips, check_session, open_clips, open_session
from mocap.io.session.settings import SessionSettings, read_session_settings

__all__ = [
    "Finding",
    "OpenedClips",
    "Session",
    "SessionSettings",
    "check_session",
    "open_clips",
    "open_session",
    "read_session_settings",
]
