# SPDX-License-Identifier: MIT
"""Run a reader's script in a process of its own: a file that never ends or ends the process does not harm ours."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stiffgen.core.errors import DescriptionError, MissingExtraError, install_command, printable

_SECONDS = 300  # of the clock; the scripts bound the processor time


def answer_of(
    script: str, file: str, request: Mapping[str, Any], package: str, extra: str, kind: str
) -> dict[str, Any]:
    """Return the answer of a script of this folder to a request; both are JSON.

    Args:
        script: name of the script.
        file: name of the robot's file, for errors.
        request: content of the request.
        package: package that the script imports.
        extra: stiffgen's extra that installs it.
        kind: kind of the file, for the message that the package is not installed.

    Raises:
        MissingExtraError: the package is not installed, or cannot be imported.
        DescriptionError: the script was ended, by its limits or by a fault of the library that it calls.

    """
    if find_spec(package) is None:
        raise MissingExtraError(
            f"{printable(file)}: is {kind}, and the package {package}, which reads it, is not installed: "
            f"{install_command(extra)}"
        )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONIOENCODING": "utf-8"}
    try:
        done = subprocess.run(
            [sys.executable, str(Path(__file__).with_name(script))],
            input=json.dumps(request),
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            env=environment,
            timeout=_SECONDS,
            check=False,
        )
        answer = json.loads(done.stdout)
    except (subprocess.TimeoutExpired, ValueError) as error:
        raise DescriptionError(
            file, ["is not read within the time and memory of a robot's file; correct what repeats in it"]
        ) from error
    assert isinstance(answer, dict)
    if "missing" in answer:
        raise MissingExtraError(
            f"{printable(file)}: {package} cannot be imported ({printable(answer['missing'], 200)}); "
            f"install it again: {install_command(extra)}"
        )
    return answer
