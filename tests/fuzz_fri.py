"""Fuzzing of the FRI client with libFuzzer, under the address and undefined-behaviour sanitizers.

    python tests/fuzz_fri.py [FOLDER] [--nanopb-source DIR] [-runs=1000000] [-seed=1] ...

Each run puts one hostile datagram into a session, through the decoder, the open library and the whole client, once for
each version. FOLDER (default: build/fri-fuzz) keeps programs and corpora. Options with one dash are libFuzzer's. With
nanopb's sources the sanitizers see into nanopb too.
"""

from __future__ import annotations

import argparse
import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from examples.fri_robot.messages import VERSIONS, IODirection, IOType, IOValue

from fri_session import SANITIZERS, TRAJECTORY, RobotScript, build, button, pack


def write_session(folder: Path, version: str) -> dict[str, str]:
    """Session and corpus for the fuzz target in a folder; returns the environment it wants."""
    script = RobotScript(version)
    ios = [button(False), IOValue("Group.Level", IOType.ANALOG, IODirection.OUTPUT, 0.5)]
    script.begin(1, 1)
    rng = np.random.default_rng(1)
    script.add(4, external_torque=rng.normal(size=7), ios=ios)
    hostile = script.message(4, ios=ios)
    script.add(4, ios=ios)
    (folder / "session").write_bytes(pack(script.datagrams))
    corpus = folder / "corpus"
    corpus.mkdir(exist_ok=True)
    body = script.protocol.unframe(hostile)
    sound = {"framed": b"\x01" + body, "raw": b"\x00" + hostile, "empty": b"", "long": b"\x00" + 1600 * b"\x0a"}
    for state in range(5):
        sound[f"state{state}"] = b"\x01" + script.protocol.unframe(script.message(state, ios=ios))
    sound["six"] = b"\x01" + script.protocol.unframe(
        script.message(4, lambda m: m.monitorData.measuredJointPosition.value.pop())
    )
    sound["length"] = b"\x00" + struct.pack("<I", 0xFFFFFFFF) + hostile[4:]
    for name, data in sound.items():
        (corpus / name).write_bytes(data)
    return {"FRI_FUZZ_SESSION": str(folder / "session"), "FRI_FUZZ_TRAJECTORY": str(TRAJECTORY)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/fri-fuzz"))
    parser.add_argument("--nanopb-source", type=Path)
    options, libfuzzer = parser.parse_known_args()
    if not any(option.startswith(("-runs", "-max_total_time")) for option in libfuzzer):
        libfuzzer.append("-runs=1000000")
    sources = [f"-DNANOPB_SOURCE_DIR={options.nanopb_source.resolve()}"] if options.nanopb_source else []
    for version in VERSIONS:
        folder = options.folder.resolve() / version
        print(f"FRI {version}: building ...", flush=True)
        build(folder, [f"-DOPEN_FRI_VERSION={version}", *sources], compiler="clang", flags=SANITIZERS, fuzzer=True)
        environment = {**os.environ, **write_session(folder, version)}
        found = f"-artifact_prefix={folder}/"
        command = [folder / "fri_fuzz", folder / "corpus", "-max_len=1700", found, *libfuzzer]
        code = subprocess.run([str(part) for part in command], env=environment).returncode
        if code != 0:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
