# SPDX-License-Identifier: MIT
"""Compiled templates are kept from process to process, and never outlive their text."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import jinja2
import pytest

from stiffgen.core import rendering


@pytest.fixture
def compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of the templates that are compiled from now on; compiled ones are kept in tmp_path/kept."""
    (tmp_path / "kept").mkdir()
    names, compile_template = [], jinja2.Environment.compile

    def note(self: jinja2.Environment, source: Any, name: str, *rest: Any, **options: Any) -> Any:
        names.append(name)
        return compile_template(self, source, name, *rest, **options)

    monkeypatch.setattr(jinja2.Environment, "compile", note)
    monkeypatch.setattr(rendering, "cache_from_source", lambda file: str(tmp_path / "kept" / "rendering.pyc"))
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    return names


def render(folder: Path, text: str, *, escaped: bool = False) -> str:
    """Write a template, and render it in a new environment, as a new process would."""
    (folder / "a.j2").write_text(text)
    return rendering.environment([folder], escaped=escaped).get_template("a.j2").render(x="<")


def test_a_template_is_compiled_again_only_with_another_text(tmp_path: Path, compiled: list[str]) -> None:
    """Render a text twice, then another one: each text is compiled once."""
    assert [render(tmp_path, text) for text in ("{{ x }}", "{{ x }}", "2 {{ x }}")] == ["<", "<", "2 <"]
    assert compiled == ["a.j2", "a.j2"]


def test_a_page_is_escaped_though_the_same_text_was_not(tmp_path: Path, compiled: list[str]) -> None:
    """Render a text plain, escaped and plain: kept templates of both kinds are not mixed up."""
    assert [render(tmp_path, "{{ x }}", escaped=escaped) for escaped in (False, True, False)] == ["<", "&lt;", "<"]
    assert len(compiled) == 2


@pytest.mark.parametrize("reason", ["read-only", "python -B"])
def test_nothing_is_kept_where_python_keeps_nothing(
    tmp_path: Path, compiled: list[str], monkeypatch: pytest.MonkeyPatch, reason: str
) -> None:
    """Render twice in a folder without rights, or under -B: compiled twice, and no file is kept."""
    if reason == "read-only":
        monkeypatch.setattr(os, "access", lambda path, mode: False)  # chmod does not bind root
    else:
        monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert [render(tmp_path, "{{ x }}") for _ in range(2)] == ["<", "<"]
    assert compiled == ["a.j2", "a.j2"] and not list((tmp_path / "kept").iterdir())
