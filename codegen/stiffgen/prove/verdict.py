# SPDX-License-Identifier: MIT
"""What a proof says of one function, and the file that holds what all of them said."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from stiffgen.errors import OutputError

Outcome = Literal["proved", "FAILED", "unproved"]


@dataclass(frozen=True)
class Verdict:
    """One row of the table.

    ``function`` is the C function (or group of functions) and ``claims`` what was claimed of it for all inputs.
    "unproved" is neither proved nor refuted: a time-out, or what a tool cannot say; ``detail`` has the reason, or the
    first findings. ``seconds`` is the tool's processor time.
    """

    function: str
    claims: str
    tool: str
    outcome: Outcome
    seconds: float
    detail: str = ""


def write_verdicts(
    file: Path, robot: str, sources: dict[str, str], tools: dict[str, str], rows: Sequence[Verdict]
) -> None:
    """Verdicts as JSON, with the digests of the C sources that they are about.

    Raises:
        OutputError: the file cannot be written.

    """
    content = {
        "robot": robot,
        "sources": sources,
        "tools": tools,
        "verdicts": [asdict(row) | {"seconds": round(row.seconds, 2)} for row in rows],
    }
    try:
        file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{file}: cannot be written ({error.strerror}); give another --json") from error


@dataclass(frozen=True)
class Filed:
    """Verdicts read back from a file."""

    robot: str
    sources: dict[str, str]
    tools: dict[str, str]
    verdicts: tuple[Verdict, ...]


def read_verdicts(file: Path) -> Filed:
    """What :func:`write_verdicts` wrote.

    Raises:
        OutputError: the file cannot be read, or is none of 'stiffgen prove'.

    """
    try:
        content: Any = json.loads(file.read_text(encoding="utf-8"))
        verdicts = tuple(Verdict(**row) for row in content["verdicts"])
        return Filed(content["robot"], dict(content["sources"]), dict(content["tools"]), verdicts)
    except OSError as error:
        raise OutputError(
            f"{file}: cannot be read ({error.strerror}); 'stiffgen prove DIR --json FILE' makes it"
        ) from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise OutputError(f"{file}: holds no verdicts; 'stiffgen prove DIR --json FILE' makes such a file") from error
