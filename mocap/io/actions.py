"""Actions of a recording: which frames show what."""

from __future__ import annotations

from pathlib import Path

from mocap.errors import MocapError
from mocap.io.tables import rows_of, whole_of

ACTION_COLUMNS = ("first_frame", "last_frame", "action")


def read_actions_csv(path: Path | str) -> list[tuple[str, int, int, int | None]]:
    """Read (action, first frame, last frame, person or None = all); both ends belong to the action.

    Columns first_frame, last_frame, action and, if it matters, person; frames as the truth numbers them.
    Raises MocapError with the line for a missing column, a number that is none, or a last frame before the first.
    """
    path = Path(path)
    actions = []
    for line, row in rows_of(path, ACTION_COLUMNS):
        first, last = whole_of(path, line, row, "first_frame"), whole_of(path, line, row, "last_frame")
        label = row["action"].strip()
        if last < first or not label:
            what = f"the last frame {last} is before the first {first}" if last < first else "action is empty"
            raise MocapError(f"line {line}: {what}", path=path, remedy="correct the table")
        person = whole_of(path, line, row, "person") if row.get("person", "").strip() else None
        actions.append((label, first, last, person))
    if not actions:
        raise MocapError(
            "the table lists no action", path=path, remedy="add rows first_frame,last_frame,action"
        )
    return actions
