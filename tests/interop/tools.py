"""Programs that the tests use where they are installed; in CI they have to be."""

from __future__ import annotations

import os
import shutil

import pytest


def need(tool: str) -> str:
    """The path of an installed program; without it the test is skipped, and in CI it fails."""
    path = shutil.which(tool)
    if path is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"{tool} is not installed")
    return path
