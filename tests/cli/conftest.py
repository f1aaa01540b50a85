"""The small session, once per process."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_session import small_session


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_session(tmp_path_factory.getbasetemp())
