# SPDX-License-Identifier: MIT
"""Files made to do harm: each is refused (or read) within seconds and 500 MB, with exit code 2, one message, no
traceback, and nothing written.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from stiffgen.core.errors import DescriptionError, StiffgenError
from stiffgen.core.loading import chain_between
from stiffgen.core.robot.chain import ChainOptions
from stiffgen.core.robot.checker import MAX_JOINTS
from stiffgen.core.robot.reader import MAX_BYTES, read_description
from support.chains import ARM
from support.confined import run_forked

SECONDS, MEGABYTES = 30, 500  # of processor time, a guard against hanging; and of memory


def tree(joints: int, *, deep: bool, kind: str = "fixed", extra: str = "") -> str:
    parts = ['<robot name="r"><link name="l0"/>']
    for k in range(1, joints + 1):
        parts.append(f'<link name="l{k}"/><joint name="j{k}" type="{kind}"><origin xyz=".1 0 0" rpy=".1 .2 .3"/>'
                     f'<parent link="l{k - 1 if deep else 0}"/><child link="l{k}"/>'
                     f"{extra.format(k - 1)}</joint>")  # fmt: skip
    return "".join(parts) + "</robot>"


def filled(unit: str, size: int = MAX_BYTES - 100) -> str:
    return '<robot name="r">' + unit * (size // len(unit)) + "</robot>"


LAUGHS = "<!DOCTYPE r [<!ENTITY a 'ha'>" + "".join(
    f"<!ENTITY {c} '{f'&{chr(ord(c) - 1)};' * 10}'>" for c in "bcdefghij"
) + "]>"  # fmt: skip
QUADRATIC = f"<!DOCTYPE r [<!ENTITY a '{'x' * 100_000}'>]><robot name='r'>{'&a;' * 100_000}</robot>"

HOSTILE = {
    "entity expansion in text": LAUGHS + "<robot name='r'>&j;</robot>",
    "entity expansion in an attribute": LAUGHS + "<robot name='&j;'/>",
    "entity expansion, quadratic": QUADRATIC,
    "external entity": "<!DOCTYPE r [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><robot name='&x;'/>",
    "external entity in text": "<!DOCTYPE r [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><robot name='r'>&x;</robot>",
    "parameter entity": "<!DOCTYPE r [<!ENTITY % x SYSTEM 'http://127.0.0.1:9/x'> %x;]><robot name='r'/>",
    "external DTD": "<!DOCTYPE robot SYSTEM 'http://127.0.0.1:9/x.dtd'><robot name='r'/>",
    "DOCTYPE in UTF-16": "<!DOCTYPE robot [<!ENTITY a 'b'>]><robot name='&a;'/>".encode("utf-16"),
    "a hundred megabytes": b"<robot name='r'>" + b" " * 100 * 2**20 + b"</robot>",
    "elements up to the size limit": filled("<a/>"),
    "attributes up to the size limit": filled('<a a="" b="" c="" d="" e="" f="" g="" h="" i="" j="" k=""/>'),
    "undeclared prefixes up to the size limit": filled("<a:b/>"),
    "faults in comments up to the size limit": filled("<!-- -- -->"),
    "nameless links up to the size limit": filled("<link/>"),
    "nameless joints up to the size limit": filled("<joint/>"),
    "as many faults as joints": filled('<link/><joint type="x"><mimic/><axis/></joint>', 40 * MAX_JOINTS),
    "thirty thousand joints": tree(30_000, deep=False),
    "a chain of ten thousand links": tree(10_000, deep=True),
    "nesting": "<robot name='r'>" + "<a>" * 100_000,
    "a name of a megabyte": ARM.replace('"elbow"', f'"{"e" * 2**20}"').replace('"0 1 0"', '"0 0 0"'),
    "a number of a megabyte": ARM.replace("0.4 0 0", f"{'4' * 2**20} 0 0"),
    "a million numbers": ARM.replace("0.4 0 0", "0 " * 2**20),
    "a long circle": tree(MAX_JOINTS, deep=True).replace('<parent link="l0"/>', f'<parent link="l{MAX_JOINTS}"/>'),
    "a long circle of mimics": tree(MAX_JOINTS, deep=True, kind="revolute", extra='<mimic joint="j{}"/>').replace(
        '"j0"', f'"j{MAX_JOINTS}"'
    ),
    "mimics that explode": tree(100, deep=True, kind="revolute", extra='<mimic joint="j{}" multiplier="9e9"/>').replace(
        '<mimic joint="j0" multiplier="9e9"/>', ""
    ),
    "a chain of mimics from its end": tree(MAX_JOINTS, deep=True, kind="revolute", extra='<mimic joint="j{}"/>'),
    "zeros": bytes(10_000),
    "0xff": b"\xff" * 10_000,
    "unknown encoding": b"<?xml version='1.0' encoding='x-no-such'?><robot name='r'/>",
    "encoding that is not true": b"<?xml version='1.0' encoding='utf-16'?><robot name='r'/>",
    "half a surrogate pair": b"<robot name='\xed\xa0\x80'/>",
    "gzip": b"\x1f\x8b\x08\x00" + bytes(range(256)),
}


def run(arguments: list[str], folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own, killed beyond its allowance of processor time (a busy machine's clock
    says nothing) and beyond four times that of memory.
    """
    limit = 4 * MEGABYTES * 2**20

    def confine() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))

    return subprocess.run(
        [sys.executable, "-c", _MEASURED, *arguments], cwd=folder, capture_output=True, text=True, errors="replace",
        timeout=60 * SECONDS, preexec_fn=confine, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"} | environment,
        check=False,
    )  # fmt: skip


_MEASURED = """
import resource, sys
from stiffgen.cli import main
code = main(sys.argv[1:])
sys.stdout.flush()
print("PEAK", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024, file=sys.stderr)
sys.exit(code)
"""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if len(text) < 20_000 else pytest.mark.slow) for name, text in HOSTILE.items()],
)
def test_refused_in_time_and_memory_and_nothing_written(tmp_path, name):
    """Read hostile files with bounded memory and time: exit code 2, no traceback, no other file."""
    content = HOSTILE[name]
    (tmp_path / "evil.urdf").write_bytes(content.encode() if isinstance(content, str) else content)
    command = "inspect" if name == "as many faults as joints" else "generate"
    done = run_forked([command, "evil.urdf"], tmp_path, MEGABYTES, SECONDS)
    *message, peak = done.stderr.strip().splitlines()
    assert done.returncode == 2, done.stderr[-500:]
    assert "Traceback" not in done.stderr
    assert any("evil.urdf" in line for line in message)
    assert int(peak.split()[1]) < MEGABYTES
    assert done.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["evil.urdf"]
    assert "root:" not in done.stderr  # of /etc/passwd
    if command == "generate":
        assert len(done.stderr) < 5000


@pytest.mark.slow
@pytest.mark.parametrize("deep", [pytest.param(False, marks=pytest.mark.wide), True])
def test_the_largest_file_is_read_in_time(tmp_path, deep):
    """Read files with the most joints allowed, in one line and side by side."""
    text = tree(MAX_JOINTS, deep=deep)
    file = tmp_path / "large.urdf"
    file.write_text(text.replace("fixed", "revolute", 1))
    description = read_description(file)
    assert chain_between(description, ChainOptions(tip=f"l{MAX_JOINTS}" if deep else "l1")).dof == 1
    if not deep:  # twice is once too often for the deep one
        assert run(["inspect", "large.urdf"], tmp_path).returncode == 0


@pytest.mark.slow
def test_truncated_at_every_byte(tmp_path):
    """Cut a file after each byte: refused, except without its trailing line end."""
    data = ARM.encode()
    whole = data.rstrip()
    file = tmp_path / "arm.urdf"
    for length in range(len(data)):
        file.write_bytes(data[:length])
        if length >= len(whole):
            assert read_description(file).problems == ()
            continue
        with pytest.raises(DescriptionError, match=r"arm\.urdf: is not well-formed"):
            read_description(file)


def test_every_byte_replaced(tmp_path):
    """Replace each byte by one that breaks text or markup: an error or a description, nothing else."""
    data = ARM.encode()
    file = tmp_path / "arm.urdf"
    refused = 0
    for at in range(0, len(data), 7):
        for byte in (b"\xff", b"<", b"0"):
            file.write_bytes(data[:at] + byte + data[at + 1 :])
            try:
                chain_between(read_description(file), ChainOptions(tip="hand"))
            except StiffgenError as error:
                refused += 1
                assert str(error).startswith("arm.urdf")
    assert refused > len(data) / 3


@pytest.mark.slow
def test_inspect_prints_every_problem_and_any_name_on_any_terminal(tmp_path):
    """Inspect names with control characters on UTF-8 and ASCII terminals: all problems, no raw character."""
    text = ARM.replace("elbow", "ellbögen\u202e").replace('"0 1 0"', '"0 0 0"').replace('effort="5"', 'effort="-5"')
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    for encoding in ("utf-8", "ascii"):
        done = run(["inspect", "arm.urdf"], tmp_path, PYTHONIOENCODING=encoding)
        assert done.returncode == 1, done.stderr
        assert "no direction" in done.stdout and '<limit effort="-5">' in done.stdout
        assert "\u202e" not in done.stdout
    (tmp_path / "arm.urdf").write_text(text.replace(' name="arm"', "").replace('"-5"', '"six"'), encoding="utf-8")
    done = run(["inspect", "arm.urdf"], tmp_path, PYTHONIOENCODING="ascii")
    assert done.returncode == 2
    for words in ("<robot> has no name", "no direction", "'six'"):
        assert words in done.stderr


def test_unreadable_file(tmp_path):
    done = run_forked(["generate", "missing\udcff.urdf"], tmp_path, MEGABYTES, SECONDS)
    assert done.returncode == 2 and "cannot be read" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_a_pipe_is_read_if_something_writes_to_it(tmp_path):
    """None waits for ever; a writer that comes late, or has long finished, is read."""
    pipe = tmp_path / "pipe.urdf"
    os.mkfifo(pipe)
    done = run_forked(["inspect", "pipe.urdf"], tmp_path, MEGABYTES, SECONDS)
    assert done.returncode == 2
    assert "nothing writes" in done.stderr and len(done.stderr.splitlines()) <= 2  # the second is the measurement
    writer = subprocess.Popen(
        ["sh", "-c", "sleep 0.2; cat > pipe.urdf"], cwd=tmp_path, stdin=subprocess.PIPE, text=True
    )
    writer.stdin.write(ARM)
    writer.stdin.close()
    assert run_forked(["inspect", "pipe.urdf"], tmp_path, MEGABYTES, SECONDS).returncode == 0
    assert writer.wait() == 0
    reading, writing = os.pipe()
    os.write(writing, ARM.encode())
    os.close(writing)
    assert read_description(f"/dev/fd/{reading}").problems == ()
    os.close(reading)
