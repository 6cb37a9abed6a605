# SPDX-License-Identifier: MIT
"""Compare many random chains with Pinocchio and read many broken files: ``python tests/campaigns/long_run.py``.

Every chain is held against Pinocchio at one posture: pose, mass matrix and the three Jacobians, and each twentieth
also the Jacobian's derivative and the joint stiffness. Broken files must be refused with a StiffgenError or read;
those still read are compared too. A case that takes more than ten seconds counts as a hang. The seed of every failure
is printed; exit code 1 if there was one.
"""

from __future__ import annotations

import argparse
import collections
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from types import FrameType

import numpy as np

from stiffgen.core.errors import StiffgenError
from stiffgen.core.loading import chain_between
from stiffgen.core.names import identifier
from stiffgen.core.robot.chain import ChainOptions
from stiffgen.core.robot.reader import read_description
from support.chain_checks import disagreements
from support.pinocchio_oracle import PinocchioChain
from support.random_urdf import Plain, broken_file, random_robot

HANG = 10  # [s]


def check_chain(seed: int, file: Path, most_moving: int) -> str:
    """Check a random chain with all oracles; return "agrees", or what is wrong."""
    size = most_moving if seed % 100 == 0 else 15 if seed % 10 == 0 else 7
    robot = random_robot(Plain(seed), min(size, most_moving))
    file.write_text(robot.text, encoding="utf-8")
    chain = chain_between(read_description(file), ChainOptions(tip=robot.tip, base=robot.base))
    oracle = PinocchioChain(robot.text, robot.tip, robot.base)
    errors = disagreements(chain, oracle, np.random.default_rng(seed), most=12 if seed % 20 == 1 else 0)
    return f"WRONG {errors}" if errors else "agrees"


def check_broken(seed: int, file: Path) -> str:
    """Return "refused", "read", "agrees", or what is wrong."""
    data = broken_file(Plain(seed))
    file.write_bytes(data)
    try:
        description = read_description(file)
        identifier(description.robot)
        chain = chain_between(description, ChainOptions(tip=description.leaves[seed % len(description.leaves)]))
    except StiffgenError as error:
        return "refused" if str(error) else "WRONG empty message"
    try:
        oracle = PinocchioChain(data, chain.tip)
        errors = disagreements(chain, oracle, np.random.default_rng(seed), most=0)
    except (ValueError, SyntaxError, AttributeError):
        return "read"  # by stiffgen alone
    return f"WRONG {errors}" if errors else "agrees"


def main() -> int:
    """Read broken files and check random chains, each seed within HANG seconds; return 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chains", type=int, default=100_000)
    parser.add_argument("--broken", type=int, default=100_000)
    parser.add_argument("--joints", type=int, default=40, help="most moving joints of a chain")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop each part after this time")
    options = parser.parse_args()
    signal.signal(signal.SIGALRM, _hang)
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.urdf"
        parts = {
            "broken files": (options.broken, lambda seed: check_broken(seed, file)),
            "chains": (options.chains, lambda seed: check_chain(seed, file, options.joints)),
        }
        for title, (count, check) in parts.items():
            tally: collections.Counter[str] = collections.Counter()
            start = time.monotonic()
            for seed in range(options.seed, options.seed + count):
                signal.alarm(HANG)
                try:
                    result = check(seed)
                except Exception:  # whatever it is, it is a failure of this seed
                    result = "CRASH " + traceback.format_exc()
                signal.alarm(0)
                tally[result.split()[0]] += 1
                if result.startswith(("WRONG", "CRASH")):
                    failed += 1
                    print(f"{title}, seed {seed}: {result}", flush=True)
                if time.monotonic() - start > options.seconds:
                    break
                if sum(tally.values()) % 5000 == 0:
                    print(f"... {sum(tally.values())} {title}, {time.monotonic() - start:.0f} s", flush=True)
            took = time.monotonic() - start
            done = sum(tally.values())
            print(f"{title}: {done} in {took:.0f} s ({done / max(took, 1e-9):.0f}/s): {dict(tally)}", flush=True)
    return 1 if failed else 0


def _hang(signum: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"no answer within {HANG} s")


if __name__ == "__main__":
    sys.exit(main())
