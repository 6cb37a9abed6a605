# SPDX-License-Identifier: MIT
"""Define verdicts of proofs, and write and read their file."""

from __future__ import annotations

import json
import stat
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from stiffgen.core.errors import OutputError

Outcome = Literal["proved", "refuted", "alarm", "no answer"]
"""Word of a verdict. "proved": the claim holds for all inputs. "refuted": ESBMC has an input for which it fails, a run
has failed, or by Eva it fails wherever its statement is reached. "alarm": Eva cannot exclude that it fails. "no
answer": a time limit, a program that gave up, or a width that this machine lacks."""

EXIT_CODES: dict[Outcome, int] = {"proved": 0, "refuted": 1, "alarm": 3, "no answer": 3}
"""Exit code of ``stiffgen prove`` for its worst verdict; 2 is a refused input."""


@dataclass(frozen=True)
class Verdict:
    """Verdict on one claim: a row of the table of ``stiffgen prove``.

    ``function`` is the C function (or group of functions) and ``claims`` what was claimed of it for all inputs.
    ``detail`` has the first findings, or the reason for no answer. ``seconds`` is the tool's processor time.
    """

    function: str
    claims: str
    tool: str
    outcome: Outcome
    seconds: float
    detail: str = ""


def worst_outcome(verdicts: Sequence[Verdict]) -> Outcome:
    """Return the worst outcome: refuted before an alarm, before no answer."""
    found = {each.outcome for each in verdicts}
    order: tuple[Outcome, ...] = ("refuted", "alarm", "no answer")
    return next((each for each in order if each in found), "proved")


def write_verdicts(
    file: Path, robot: str, sources: dict[str, str], tools: dict[str, str], rows: Sequence[Verdict]
) -> None:
    """Write verdicts as JSON, with the digests of their C sources.

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


_MOST_BYTES = 1 << 26


@dataclass(frozen=True)
class VerdictFile:
    """Content of a file of verdicts."""

    robot: str
    sources: dict[str, str]
    tools: dict[str, str]
    verdicts: tuple[Verdict, ...]


def read_content(file: Path) -> Any:
    """Read a file of JSON; OSError, ValueError or RecursionError for a device, a large file or other contents."""
    status = file.stat()
    if not stat.S_ISREG(status.st_mode) or status.st_size > _MOST_BYTES:  # a device has no end
        raise ValueError(f"no regular file of at most {_MOST_BYTES} bytes")
    return json.loads(file.read_text(encoding="utf-8"))


def read_verdicts(file: Path) -> VerdictFile:
    """Read the file that :func:`write_verdicts` wrote.

    Raises:
        OutputError: the file cannot be read, or 'stiffgen prove' did not write it.

    """
    try:
        content = read_content(file)
        verdicts = tuple(_verdict(row) for row in content["verdicts"])
        return VerdictFile(str(content["robot"]), dict(content["sources"]), dict(content["tools"]), verdicts)
    except OSError as error:
        raise OutputError(
            f"{file}: cannot be read ({error.strerror}); 'stiffgen prove DIR --json FILE' makes it"
        ) from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise OutputError(
            f"{file}: holds no verdicts ({error}); 'stiffgen prove DIR --json FILE' makes such a file"
        ) from error


def _verdict(row: Any) -> Verdict:
    """Return a row as a verdict; ValueError if its outcome or the type of a field is unknown."""
    verdict = Verdict(**row)
    if verdict.outcome not in get_args(Outcome):
        raise ValueError(f"outcome {verdict.outcome!r} is none of {', '.join(get_args(Outcome))}")
    texts = (verdict.function, verdict.claims, verdict.tool, verdict.detail)
    if not all(isinstance(text, str) for text in texts) or not isinstance(verdict.seconds, (int, float)):
        raise ValueError("a field has another type")
    if not 0.0 <= verdict.seconds < 1e9:  # a larger integer cannot be printed as a number of seconds
        raise ValueError("a time is negative or endless")
    return verdict
