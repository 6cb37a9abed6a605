# SPDX-License-Identifier: MIT
"""Fuzzing of the FRI client with libFuzzer, under the address and undefined-behaviour sanitizers.

    python tests/campaigns/fuzz_fri.py [FOLDER] [--version 2.7] [--nanopb-source DIR] [-runs=1000000] [-seed=1] ...

Each run puts one hostile datagram into a session, through the decoder, the open library and the whole client, once for
each version. FOLDER (default: build/fri-fuzz) keeps programs and corpora. Options with one dash are libFuzzer's. With
nanopb's sources the sanitizers see into nanopb too. The short form is a test of fri/tests/test_fri_wire.py, with
programs that other tests need as well.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from fri.robot.messages import VERSIONS
from fri.support.session import FUZZER, SANITIZERS, build, fuzz


def main() -> int:
    """Build the fuzzers of the chosen FRI versions and run them; return the first exit code that is not 0."""
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
        options_of_cmake = [f"-DOPEN_FRI_VERSION={version}", *sources]
        build(folder, options_of_cmake, compiler="clang", flags=SANITIZERS, targets=[FUZZER])
        code = fuzz(folder, folder, version, libfuzzer)
        if code != 0:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
