# SPDX-License-Identifier: MIT
"""Times of the FRI client's callback, against those of an older client in one run.

    python tests/campaigns/fri_callback.py COMMIT [FOLDER] [--cycles 20000] [--repeats 5]

Both clients, each with the robot of its commit, are built with the same flags and meet the same messages in turn, one
after the other as fast as they answer. What is compared is the least of the repeats: the machine may be busy.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from examples.fri_robot.messages import SessionState
from support.fri_served import served
from support.fri_session import POSTURE, RobotScript, compilers, run_cmake
from support.project import ROOT

FIGURES = ("callback_median_us", "callback_9999_us", "callback_worst_us")


def build(sources: Path, folder: Path) -> Path:
    """The client of a source tree, with the iiwa 14."""
    options = ["-DOPEN_FRI_VERSION=2.7", *compilers("gcc", "-O3 -DNDEBUG")]
    client = ["-S", sources / "examples" / "fri_client", "-B", folder, *options]
    run_cmake(client, ["--build", folder, "-j2"])
    return folder / "fri_wiping"


def extracted(commit: str, folder: Path) -> Path:
    """What a commit had of the client and its robot."""
    folder.mkdir(parents=True, exist_ok=True)
    archive = subprocess.run(["git", "archive", commit, "examples/fri_client", "generated/iiwa14"], cwd=ROOT,
                             check=True, stdout=subprocess.PIPE).stdout  # fmt: skip
    subprocess.run(["tar", "-x", "-C", folder], input=archive, check=True)
    return folder


def script(cycles: int) -> list[bytes]:
    """An arm that sways while it is commanded, and the end."""
    told = RobotScript("2.7")
    told.begin()
    for k in range(cycles):
        sway = 0.02 * np.sin(2 * np.pi * (0.3 + 0.1 * np.arange(7)) * k * 0.005)
        told.add(SessionState.COMMANDING_ACTIVE, position=POSTURE + sway)
    return [datagram for datagram in told.datagrams if datagram is not None] + [told.message(SessionState.IDLE)]


def times(program: Path, datagrams: list[bytes], summary: Path, *options: str) -> list[float]:
    """FIGURES [us] of a session."""
    with served(program, "--summary", summary, *options) as session:
        for datagram in datagrams[:-1]:
            session.ask(datagram)
        session.send(datagrams[-1])
        session.end()
    told = json.loads(summary.read_text())
    return [float(told[name]) for name in FIGURES]


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit")
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/fri-callback"))
    parser.add_argument("--cycles", type=int, default=20000)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    folder = options.folder.resolve()
    programs = {
        "old": (build(extracted(options.commit, folder / "sources"), folder / "old"), ()),
        "new": (build(ROOT, folder / "new"), ("--simulated-time", "--hold-time", "1000", "--speed-share", "1")),
    }
    datagrams = script(options.cycles)
    least = {name: np.full(len(FIGURES), np.inf) for name in programs}
    for _ in range(options.repeats):
        for name, (program, more) in programs.items():
            found = times(program, datagrams, folder / f"{name}.json", *more)
            least[name] = np.minimum(least[name], found)
            print(name, *(f"{figure} {value:g}" for figure, value in zip(FIGURES, found, strict=True)), flush=True)
    for figure, old, new in zip(FIGURES, least["old"], least["new"], strict=True):
        print(f"{figure}: old {old:g}, new {new:g}, ratio {new / old:.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
