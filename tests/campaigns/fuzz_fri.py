# SPDX-License-Identifier: MIT
"""Fuzzing of the FRI client with libFuzzer, under the address and undefined-behaviour sanitizers.

    python tests/campaigns/fuzz_fri.py [FOLDER] [--version 2.7] [--nanopb-source DIR] [-runs=1000000] [-seed=1] ...

Each run puts one hostile datagram into a session, through the decoder, the open library and the whole client, once for
each version. FOLDER (default: build/fri-fuzz) keeps programs and corpora. Options with one dash are libFuzzer's. With
nanopb's sources the sanitizers see into nanopb too.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

from fri.robot.messages import VERSIONS
from fri.support.session import SANITIZERS, build, write_session


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/fri-fuzz"))
    parser.add_argument("--nanopb-source", type=Path)
    parser.add_argument("--version", choices=VERSIONS, action="append", help="this one alone; may be repeated")
    options, libfuzzer = parser.parse_known_args()
    if not any(option.startswith(("-runs", "-max_total_time")) for option in libfuzzer):
        libfuzzer.append("-runs=1000000")
    sources = [f"-DNANOPB_SOURCE_DIR={options.nanopb_source.resolve()}"] if options.nanopb_source else []
    for version in options.version or VERSIONS:
        folder = options.folder.resolve() / version
        print(f"FRI {version}: building ...", flush=True)
        build(folder, [f"-DOPEN_FRI_VERSION={version}", *sources], compiler="clang", flags=SANITIZERS, fuzzer=True)
        # A small quarantine: pages met for the first time would take most of the time.
        environment = {"ASAN_OPTIONS": "quarantine_size_mb=8", **os.environ, **write_session(folder, version)}
        found = f"-artifact_prefix={folder}/"
        command = [folder / "fri_fuzz", folder / "corpus", "-max_len=1700", found, *libfuzzer]
        code = subprocess.run([str(part) for part in command], env=environment).returncode
        if code != 0:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
