"""A session folder: its settings, its sources, its frames, and the rules that open and check it."""

from mocap.io.session.record import Finding, Session
from mocap.io.session.rules import check_session, open_session
from mocap.io.session.settings import SessionSettings, read_session_settings

__all__ = [
    "Finding",
    "Session",
    "SessionSettings",
    "check_session",
    "open_session",
    "read_session_settings",
]
