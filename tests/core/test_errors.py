# SPDX-License-Identifier: MIT
"""Messages name the place from which an extra can be installed: where stiffgen itself came from."""

from __future__ import annotations

import importlib.metadata
import json
from types import SimpleNamespace

import pytest

from stiffgen.core.errors import install_command


@pytest.mark.parametrize(
    ("origin", "command"),
    [
        ({"url": "file:///home/me/stiff%20gen", "dir_info": {"editable": True}}, "-e '/home/me/stiff gen[mjcf]'"),
        ({"url": "file:///home/me/stiffgen", "dir_info": {}}, "'/home/me/stiffgen[mjcf]'"),
        (
            {"url": "file:///tmp/stiffgen-1-py3-none-any.whl", "archive_info": {}},
            "'/tmp/stiffgen-1-py3-none-any.whl[mjcf]'",
        ),
        (
            {"url": "https://example.org/stiffgen", "vcs_info": {"vcs": "git", "commit_id": "0"}},
            "'stiffgen[mjcf] @ git+https://example.org/stiffgen'",
        ),
        (None, "'stiffgen[mjcf]'"),
    ],
)
def test_an_extra_comes_from_where_stiffgen_came_from(
    origin: dict[str, object] | None, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Install from a clone, a copy, a wheel, a repository, an index: the command for an extra names the same place."""
    record = None if origin is None else json.dumps(origin)
    found = SimpleNamespace(read_text=lambda name: record if name == "direct_url.json" else None)
    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: found)
    assert install_command("mjcf") == f"pip install {command}"


def test_without_a_record_of_the_package_its_name_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", missing)
    assert install_command("mjcf") == "pip install 'stiffgen[mjcf]'"
