# SPDX-License-Identifier: MIT
"""Signals at the worst moment: between the making of something and the block that takes it away."""

from __future__ import annotations

import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import pytest

from stiffgen.core.emit.build import run_all
from stiffgen.core.folder import swapped_in, temporary_folder, write_atomically
from stiffgen.lab.prove import tools


class Ended(BaseException):
    """What a handler of signals raises, as the command line's does."""


ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
EndedBy = Callable[[signal.Signals], Callable[[int, object], None]]


@pytest.fixture
def ended_by() -> Iterator[EndedBy]:
    """Return a function that makes a signal raise ``Ended``, and returns the handler."""
    before: dict[signal.Signals, Any] = {}

    def end(number: int, frame: object) -> None:
        raise Ended

    def install(number: signal.Signals) -> Callable[[int, object], None]:
        before[number] = signal.signal(number, end)
        return end

    yield install
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", ENDING)
@pytest.mark.parametrize("what", ["result", "temporary", "file"])
def test_a_signal_while_a_folder_is_made_leaves_nothing(
    what: str, number: signal.Signals, ended_by: EndedBy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Send a signal between the making of a folder or file and the block that removes it: nothing is left."""

    def interrupted(make: Callable[..., Any]) -> Callable[..., Any]:
        def call(**given: Any) -> Any:
            made = make(**given)
            signal.raise_signal(number)
            return made

        return call

    def written() -> AbstractContextManager[None]:
        write_atomically(tmp_path / "file", "text")
        return nullcontext()

    blocks: dict[str, Callable[[], AbstractContextManager[Any]]] = {
        "result": lambda: swapped_in(tmp_path / "new" / "arm"),
        "temporary": lambda: temporary_folder("build"),
        "file": written,
    }
    for name in ("mkdtemp", "mkstemp"):
        monkeypatch.setattr(tempfile, name, interrupted(getattr(tempfile, name)))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    handler = ended_by(number)
    with pytest.raises(Ended), blocks[what]():
        pytest.fail("the block began")
    assert signal.getsignal(number) is handler
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", ENDING)
@pytest.mark.parametrize("what", ["compiler", "prover"])
def test_a_signal_while_a_program_starts_leaves_none_running(
    what: str, number: signal.Signals, ended_by: EndedBy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Send a signal while a program starts, before its function has returned: none is left running."""
    started: list[subprocess.Popen[Any]] = []
    command = ["sleep", "600"]
    run: dict[str, Callable[[], object]] = {
        "compiler": lambda: run_all([command, command], "cc", tmp_path),
        "prover": lambda: tools.run(command, tmp_path, 600.0),
    }

    class Interrupted(subprocess.Popen[Any]):
        def __init__(self, *given: Any, **options: Any) -> None:
            super().__init__(*given, **options)
            started.append(self)
            signal.raise_signal(number)

    monkeypatch.setattr(subprocess, "Popen", Interrupted)
    ended_by(number)
    try:
        with pytest.raises(Ended):
            run[what]()
        assert [process.wait(20) for process in started] == [-signal.SIGKILL] * len(started) != []
    finally:
        for process in started:
            process.kill()
