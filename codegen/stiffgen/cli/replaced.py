# SPDX-License-Identifier: MIT
"""Options of earlier versions, each with what takes its place; CHANGELOG.md has the table."""

from __future__ import annotations

from collections.abc import Sequence

_TOOL = {
    "--tool-xyz": "--tool xyz=X,Y,Z",
    "--tool-rpy": "--tool rpy=R,P,Y",
    "--tool-mass": "--tool mass=KG",
    "--tool-com": "--tool com=X,Y,Z",
    "--tool-inertia": "--tool inertia=IXX,IXY,IXZ,IYY,IYZ,IZZ",
}
_NAMED = {"--robot": "the name in place of the file"}
_GENERATED = dict.fromkeys(
    ("--ignore", "--accept-inertia", "--package-path"), "generate with it, then the folder that it writes"
)
_WORDS = "words behind the folder: DIR PART KERNEL ..."
REPLACED = {
    "generate": _TOOL
    | {
        "--translation-axes": "--placement translation_axes=AXES",
        "--rotation-axes": "--placement rotation_axes=AXES",
        "--spring-centre": "--placement centre=X,Y,Z",
        "--sensor-xyz": "--sensor xyz=X,Y,Z",
        "--sensor-rpy": "--sensor rpy=R,P,Y",
        "--sensor-sign": "--sensor sign=robot",
        "--force": "removing the folder, or force=True in Python",
    },
    "new": _TOOL | _NAMED | {"--spring": "--controller spring=KIND"},
    "inspect": _NAMED
    | {
        "--base": "nothing: a chain begins at the link nearest the root",
        "--ignore": "generate with it: inspect names all problems without it",
        "--accept-inertia": "generate with it: inspect names all problems without it",
    },
    "play": _NAMED | _GENERATED | {"--no-open": "--output FILE.html: a page with a name is not opened"},
    "analyze": {
        "--q-columns": "--q",
        "--wrench-columns": "--wrench",
        "--q-topic": "--topic",
        "--wrench-topic": "--topic",
    },
    "calibrate": {"--picture": "a second --output FILE.svg", "--at": "--check KG,X,Y,Z"},
    "measure": {"--rotation": "nothing: the columns' names or number tell", "--tared": "--calibration none"},
    "prove": {"--part": _WORDS, "--only": _WORDS},
    "verify": {
        "--urdf": "the file behind the folder: DIR URDF",
        "--seed": "--samples COUNT,SEED",
        "--proofs": "--evidence FILE",
        "--targets": "--evidence FILE",
        "--date": "nothing: the page has no date",
    },
}
"""By command, then by option."""


def refusal(command: str, words: Sequence[str]) -> str:
    """Return the refusal of words that a command does not take, with what takes the place of each old option."""
    known = REPLACED.get(command, {})
    old = dict.fromkeys(word.partition("=")[0] for word in words)
    told = [f"in place of {option}: {known[option]}" for option in old if option in known]
    return "; ".join([f"unrecognized arguments: {' '.join(words)}", *told])
