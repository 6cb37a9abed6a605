# SPDX-License-Identifier: MIT
"""Receipts of runs that CI cannot make: on a GPU, in real ros2_control, over hours.

    python -m campaigns.receipts                    list the receipts, and whether their sources are those of today
    python -m campaigns.receipts NAME COMMAND ...   run the command; write docs/receipts/NAME.json if it succeeds

``make bench-cuda`` and ``make campaign NAME=... RECEIPT=yes`` write theirs in the same way. A receipt has the command,
the commit, a digest of the sources, the processor, the seconds, and all that the run printed. Pages link to it and name
the digest; tests/house/test_receipts.py compares each of their numbers with what was printed. RECEIPTS names another
folder to write to.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.tools import processor
from support.project import ROOT

FOLDER = ROOT / "docs" / "receipts"
FOLDERS = ("benchmarks", "codegen/stiffgen", "fri", "ros2", "tests/campaigns", "tests/support", "urdf")
KINDS = {".c", ".cpp", ".cu", ".h", ".hpp", ".j2", ".js", ".py", ".urdf", ".xml"}
"""Folders and kinds of files that can change a run's numbers."""
BY_COMMAND = "by the command"
BEFORE = "before receipts existed"
"""Recorded by hand: the output is what a page stated, with the commit that stated it."""
LINES = 400
"""Lines of output that a receipt keeps, the last ones."""


@dataclass(frozen=True)
class Receipt:
    """Record of one run."""

    command: str
    recorded: str
    commit: str
    """First digits of the commit, with ``+`` behind them if files differed from it."""
    sources: str
    """Digest of the sources (:func:`digest`)."""
    processor: str
    seconds: float | None
    output: list[str]


def digest(root: Path = ROOT) -> str:
    """Return the first 12 digits of the SHA-256 of the sources: paths and contents, tests themselves left out."""
    found = hashlib.sha256()
    for folder in FOLDERS:
        for file in sorted((root / folder).rglob("*")):
            if file.suffix in KINDS and file.is_file() and not file.name.startswith("test_"):
                content = hashlib.sha256(file.read_bytes()).hexdigest()
                found.update(f"{file.relative_to(root).as_posix()} {content}\n".encode())
    return found.hexdigest()[:12]


def read(folder: Path = FOLDER) -> dict[str, Receipt]:
    """Return the receipts of a folder by name."""
    return {file.stem: Receipt(**json.loads(file.read_text())) for file in sorted(folder.glob("*.json"))}


def _commit() -> str:
    """Return the commit, empty outside a clone: a test then asks for it."""
    if shutil.which("git") is None:
        return ""

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False)
        return done.stdout.strip()

    commit = git("rev-parse", "--short=12", "HEAD")
    return commit + "+" if commit and git("status", "--porcelain", "--", *FOLDERS) else commit


def _anonymous(line: str) -> str:
    """Replace the places and the name of this machine."""
    for text, instead in ((str(ROOT), "."), (tempfile.gettempdir(), "TMP"), (str(Path.home()), "HOME")):
        line = re.sub(rf"{re.escape(text)}(?![\w.-])", instead, line)
    return re.sub(rf"\b{re.escape(platform.node() or '-')}\b", "HOST", line)


def run(name: str, command: Sequence[str], said: str = "") -> int:
    """Run a command from the repository's root, print what it prints, and write its receipt.

    Args:
        name: the receipt's name.
        command: words of the command line.
        said: the command as a user types it, default the words themselves.

    Returns:
        the command's exit status; there is a receipt if it is 0.

    """
    sources, commit, started, output = digest(), _commit(), time.monotonic(), list[str]()
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, errors="replace") as process:
        for line in process.stdout or ():
            print(line, end="", flush=True)
            output.append(_anonymous(line.rstrip()))
    if process.returncode:
        print(f"no receipt is written: exit status {process.returncode}", file=sys.stderr)
        return process.returncode
    seconds = round(time.monotonic() - started, 1)
    receipt = Receipt(
        _anonymous(said or shlex.join(command)), BY_COMMAND, commit, sources, processor(), seconds, output[-LINES:]
    )
    folder = Path(os.environ.get("RECEIPTS", FOLDER))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(json.dumps(asdict(receipt), indent=2) + "\n")
    print(f"receipt: {name}.json, sources {sources}")
    return 0


def main(words: Sequence[str]) -> int:
    """Run the command behind a name, or list the receipts."""
    if len(words) > 1:
        return run(words[0], words[1:])
    now = digest()
    print(f"sources of today: {now}")
    for name, receipt in read().items():
        state = "of today" if receipt.sources == now else f"older, commit {receipt.commit}"
        print(f"  {name:20} sources {receipt.sources} ({state}), recorded {receipt.recorded}: {receipt.command}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
