# SPDX-License-Identifier: MIT
"""Coverage-guided fuzzing of the URDF reader with atheris.

    python tests/campaigns/fuzz_reader.py [FOLDER] [-max_total_time=600] [-runs=N -seed=S] ...

FOLDER keeps the corpus (default: build/fuzz-corpus); it starts with small valid and broken robots. Options are
libFuzzer's; without any the run takes ten minutes. Anything but a description or a StiffgenError is a crash, more than
ten seconds a hang, more than 700 MB in all too much; libFuzzer then leaves the input in FOLDER/found.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(
    include=[
        *(f"stiffgen.core.robot.{module}" for module in ("reader", "checker", "urdf_format", "chain")),
        "stiffgen.core.errors",
        "yourdfpy",
    ]
):
    from stiffgen.core.loading import chain_between
    from stiffgen.core.robot.chain import ChainOptions
    from stiffgen.core.robot.reader import read_description

from stiffgen.core.errors import DescriptionError, StiffgenError
from stiffgen.core.names import c_string, comment, identifier
from support.random_urdf import Plain, broken_file, random_robot

_DICTIONARY = r"""
"<robot name=\""
"<link name=\""
"<joint name=\""
"type=\"revolute\""
"type=\"fixed\""
"<parent link=\""
"<child link=\""
"<origin xyz=\""
"rpy=\""
"<axis xyz=\""
"<limit lower=\""
"upper=\""
"<mimic joint=\""
"multiplier=\""
"offset=\""
"<inertial>"
"<mass value=\""
"<inertia ixx=\""
"<!DOCTYPE"
"<!ENTITY"
"<![CDATA["
"encoding=\""
"xmlns=\""
"<xacro:"
"nan"
"inf"
"1e400"
"${"
"&#0;"
"""


class Reader:
    """What libFuzzer calls with every input."""

    def __init__(self, scratch: Path) -> None:
        self.file = scratch / "fuzzed.urdf"

    def __call__(self, data: bytes) -> None:
        """Read the fuzzed file: it is refused with a printable message, or gives finite chains."""
        self.file.write_bytes(data)
        try:
            description = read_description(self.file)
        except DescriptionError as error:
            assert error.full.startswith("fuzzed.urdf:"), error.full
            assert str(error).isprintable() or "\n  " in str(error)
            return
        for text in (description.robot, *description.links):
            assert identifier(text) and comment(text) and c_string(text)
        for leaf in description.leaves[:3]:
            for masses in (True, False):
                try:
                    chain = chain_between(description, ChainOptions(tip=leaf, masses=masses))
                except StiffgenError as error:
                    assert str(error).startswith("fuzzed.urdf"), str(error)
                else:
                    assert 1 <= chain.dof <= len(chain.joints)
                    _assert_finite(chain.joints, chain.tip_rotation, chain.tip_translation)


def _assert_finite(joints, *matrices) -> None:
    """Fail if a number of the joints or matrices is infinite, NaN or beyond 1e300."""
    numbers = [*matrices]
    for joint in joints:
        body = joint.body
        numbers += [joint.rotation, joint.translation, joint.axis, joint.multiplier, joint.offset]
        numbers += [body.mass, body.moment, body.tensor]
    while numbers:
        number = numbers.pop()
        if isinstance(number, tuple):
            numbers += number
        else:
            assert abs(number) < 1e300, number


def main() -> None:
    """Write a corpus of valid and broken files, and fuzz the reader of URDF files with it."""
    folders = [argument for argument in sys.argv[1:] if not argument.startswith("-")]
    options = [argument for argument in sys.argv[1:] if argument.startswith("-")]
    corpus = Path(folders[0] if folders else "build/fuzz-corpus")
    found = corpus / "found"
    found.mkdir(parents=True, exist_ok=True)
    for seed in range(40):
        (corpus / f"valid-{seed}").write_text(random_robot(Plain(seed), 3).text, encoding="utf-8")
        (corpus / f"broken-{seed}").write_bytes(broken_file(Plain(seed), 3))
    dictionary = corpus / "found" / "dictionary.txt"
    dictionary.write_text(_DICTIONARY, encoding="utf-8")
    if not any(option.startswith(("-max_total_time=", "-runs=")) for option in options):
        options.append("-max_total_time=600")
    defaults = [
        "-timeout=10",
        "-rss_limit_mb=700",
        "-max_len=8192",
        f"-artifact_prefix={found}/",
        f"-dict={dictionary}",
    ]
    with tempfile.TemporaryDirectory() as scratch:
        atheris.Setup([sys.argv[0], *defaults, *options, str(corpus)], Reader(Path(scratch)))
        atheris.Fuzz()


if __name__ == "__main__":
    main()
