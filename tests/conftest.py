"""What all tests share: hypothesis settings, slow tests on request, and a body as voxels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from mocap.pipeline.stale import forget_stale_kernels

if TYPE_CHECKING:
    from flesh_voxels import Flesh

# No deadline: the first example compiles kernels. Derandomised: the same examples in every run.
settings.register_profile("mocap", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("mocap")


def pytest_configure(config: pytest.Config) -> None:
    """Kernels are tested as their sources are."""
    forget_stale_kernels()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Slow tests run only when the mark expression names them."""
    if "slow" in config.option.markexpr:
        return
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="slow: run with -m slow"))


@pytest.fixture(scope="session")
def flesh() -> Flesh:
    """The default body, 1.74 m, in voxels of 2 cm."""
    from flesh_voxels import make_flesh

    return make_flesh("anthropometric", 1.74, 0.02)


@pytest.fixture(scope="session")
def coarse_flesh() -> Flesh:
    """The default body, 1.74 m, in voxels of 4 cm."""
    from flesh_voxels import make_flesh

    return make_flesh("anthropometric", 1.74, 0.04)


@pytest.fixture
def open3d() -> None:
    """Skips the test without Open3D, which is an extra that no default installation has."""
    from mocap.errors import MissingExtra
    from mocap.volume._open3d import require_open3d

    try:
        require_open3d("this test")
    except MissingExtra as error:
        pytest.skip(error.message)
