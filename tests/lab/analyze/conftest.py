# SPDX-License-Identifier: MIT
"""Fixtures of the tests of ``stiffgen analyze``."""

from __future__ import annotations

import pytest


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path
