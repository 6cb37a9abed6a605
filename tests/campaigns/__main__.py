# SPDX-License-Identifier: MIT
"""Run a campaign by its name: ``make campaign NAME=soak OPTIONS="--steps 1000"``; without a name, list all campaigns.

``RECEIPT=yes`` (first word ``--receipt``) records the run in docs/receipts (receipts.py).

A campaign is a search that takes minutes to hours. ``short`` are the options of its form with a fixed seed, which
tests/campaigns/test_short_forms.py runs: in CI, or with ``make test-wide`` where ``in_ci`` is false, because other
tests in CI run the same programs; {folder} is an empty folder, {ur5} one where that arm is made. A campaign without
them needs a download that CI does not make, or shares its programs with tests, which run its short form.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from campaigns import receipts
from support.project import ROOT


@dataclass(frozen=True)
class Campaign:
    """A program, its options, and what it does."""

    program: str
    summary: str
    short: str | None = None
    full: str = ""
    in_ci: bool = True

    def command(self, options: Sequence[str]) -> list[str]:
        """Return the command line that runs the program from the repository's root."""
        run = ["-m", "pytest", "-p", "no:cacheprovider"] if self.program.endswith("wrapper.py") else []
        return [sys.executable, *run, self.program, *options]


def _campaign(name: str, summary: str, short: str | None = None, full: str = "", in_ci: bool = True) -> Campaign:
    return Campaign(f"tests/campaigns/{name}.py", summary, short, full, in_ci)


CAMPAIGNS = {
    "fuzz": _campaign("fuzz_reader", "fuzz the URDF reader for ten minutes", None, "build/fuzz-corpus"),
    "fuzz-recordings": _campaign("fuzz_recordings", "read 200 000 damaged recordings", "1000"),
    "versions": _campaign("versions", "compare robots made with the oldest and newest packages allowed"),
    "sine-cosine": _campaign("sine_cosine", "derive the polynomials of sine and cosine, and measure them"),
    "follow": _campaign(
        "follow", "send Follow to random poses and back on random arms", "tests/data/scara.urdf --arms 1 --legs 4"
    ),
    "spring-orbits": _campaign("spring_orbits", "compare the work of springs and laws on closed orbits"),
    "random-robots": _campaign(
        "long_run", "compare 100 000 random chains with Pinocchio", "--chains 2 --broken 2 --joints 4"
    ),
    "wheels": _campaign("wheels", "build the wheels of robots, and import each on every Python"),
    "first-picture": _campaign("first_picture", "time a new user's way from the wheel to the playground"),
    "robots": _campaign(
        "robots_table", "compare real robots with Pinocchio and MuJoCo, into docs/robots.md", None, "build/robots"
    ),
    "random-warnings": _campaign("compiler_warnings", "compile random robots by gcc at every level"),
    "pairs": _campaign(
        "pairs",
        "compare springs between two tips with 60 digits, and sum up their work",
        "--trees 1 --orbits 1",
        in_ci=False,
    ),
    "spring-digits": _campaign("springs_digits", "compare every spring with 60 digits", "1 1 pose", in_ci=False),
    "linkages": _campaign("linkages", "compare 200 random linkages with 60 digits", "2 1", in_ci=False),
    "compliance": _campaign(
        "compliance",
        "compare the tip's compliance in 200 trees with verify's oracles",
        "--trees 1 --postures 6",
        in_ci=False,
    ),
    "flags": _campaign(
        "flag_pairs",
        "build with single flags and pairs of every compiler",
        "--compilers clang --pairs 1",
        in_ci=False,
    ),
    "rounding-errors": _campaign(
        "rounding_errors",
        "compare measured rounding errors with their bounds",
        "--states 400 --width SSE2",
        in_ci=False,
    ),
    "float-sines": _campaign(
        "float_sines", "pass every float through sine and cosine", "--builds 'gcc, SSE2' --every 16", in_ci=False
    ),
    "mutations": _campaign("mutations", "count the mutants of a controller that verify kills"),
    "kernel-mutations": Campaign(
        "tests/campaigns/mutations.py",
        "count the mutants of kernels that verify kills",
        "--part kernels --count 1",
        "--part kernels",
        in_ci=False,
    ),
    "false-alarms": _campaign(
        "false_alarms",
        "search small random robots for false alarms of verify",
        "--robots 3 --seed 44 --samples 40",
        in_ci=False,
    ),
    "single-precision": _campaign(
        "single_precision",
        "compare time and errors of float with double",
        "--states 10000 --width SSE2 --kernels hybrid_jacobian",
        in_ci=False,
    ),
    "targets": _campaign(
        "targets",
        "count instructions on emulated processors",
        "--states 16 --machines aarch64 --functions spring_wrench",
        in_ci=False,
    ),
    "cuda": _campaign(
        "cuda",
        "run every CUDA launch function on a GPU against the C code",
        "--host --robots dual_arm --rows 40",
        in_ci=False,
    ),
    "proofs": _campaign("proofs", "prove whole folders", None),
    "hazards": _campaign("hazards", "see the test of each hazard fail on its seeded fault"),
    "seeded-faults": _campaign("seeded_faults", "prove folders with seeded faults", None),
    "soak": _campaign(
        "soak",
        "run the controller for a million hostile steps",
        "--steps 12000 --matrices 20 --builds threads valgrind",
        in_ci=False,
    ),
    "nuisance": _campaign(
        "nuisance", "count faults in harmless episodes of four arms", "--episodes 3 --arms ur5 --folder {ur5}"
    ),
    "harmless": _campaign(
        "harmless",
        "count alarms in 1000 harmless sessions, and wire arms wrongly",
        "--sessions 12 --arms iiwa14 --folder {iiwa14}",
    ),
    "compare": _campaign(
        "compare",
        "compare the controller with laws in use, into docs/results.md",
        "--arms ur5",
        "--count --output docs/results.md",
        in_ci=False,
    ),
    "energy": _campaign("energy", "attack the controller's energy bound", "--count 4 --climb 2", in_ci=False),
    "force": _campaign(
        "force",
        "measure Settle, Press and friction on three arms against their bars",
        "--arms iiwa14 --postures 1 --rows 'rest,wall 1e5,moving wall 1e4,bowl' --folder {iiwa14}",
    ),
    "motors": _campaign(
        "motors",
        "measure the stiffness that motors with a controller inside allow",
        "--hosts 200 --postures 1 --first 25600 --ratio 4 --least 2",
        in_ci=False,
    ),
    "passport": _campaign(
        "passport",
        "compare the stiffness passport of eight arms with MuJoCo",
        "--arms iiwa14 --postures 1 --loops 1 --controller",
        "--controller",
        in_ci=False,
    ),
    "starts": _campaign(
        "starts",
        "start four arms with wrong first samples and memory",
        "--episodes 18 --trials 500 --arms ur5 --folder {ur5}",
    ),
    "hostile": _campaign("hostile", "flip bits of the controller's state", "--steps 12000 --flips 240", in_ci=False),
    "fri-fuzz": _campaign("fuzz_fri", "send the FRI client a million hostile datagrams"),
    "fri-attack": _campaign("attack_fri", "attack the FRI client in whole sessions"),
    "vendor": _campaign(
        "vendor", "compare robots of makers' repositories in a folder", "../shared/data/vendor fr3 ur5e --tips 2"
    ),
    "recordings": _campaign("recordings", "estimate the asymmetry from recordings of a real arm, in a folder"),
    "fri-frozen": _campaign(
        "frozen_fri",
        "freeze measured positions under the FRI client",
        "{folder} --faulty 6 --kinds one,several,all --harmless 6 --seed 3",
        in_ci=False,
    ),
    "rooms": _campaign("rooms", "delete each optional room in a copy, and run the tests of the kernels"),
    "torch": _campaign("torch_wrapper", "test NAME.torch"),
    "drake": Campaign("tests/campaigns/drake_conventions.py", "test docs/wrench.md against Drake"),
}


def main(words: Sequence[str]) -> int:
    """Run the campaign that the first word names; behind ``--receipt``, record its run."""
    recorded = words[:1] == ["--receipt"]
    words = words[recorded:]
    if not words or words[0] not in CAMPAIGNS:
        for name, campaign in CAMPAIGNS.items():
            print(f"  make campaign NAME={name:17} {campaign.summary}")
        return 2 if words else 0
    name, campaign = words[0], CAMPAIGNS[words[0]]
    options = words[1:] or campaign.full.split()
    if recorded:
        said = f' OPTIONS="{shlex.join(options)}"' if options else ""
        return receipts.run(name, campaign.command(options), f"make campaign NAME={name}{said}")
    return subprocess.run(campaign.command(options), cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
