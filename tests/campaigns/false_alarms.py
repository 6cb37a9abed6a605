# SPDX-License-Identifier: MIT
"""Search for false alarms of ``stiffgen verify``: small random robots, whose functions are CasADi's own.

    python tests/campaigns/false_alarms.py --robots 200 --seed 0

Each robot has one to three moving joints and one to three tips. CasADi evaluates the formulas that the C code is
printed from; therefore every comparison that fails is a false alarm. No compiler is needed.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from xml.etree import ElementTree

import stiffgen
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.oracles import check_robot
from stiffgen.core.verify.result import Check
from stiffgen.core.verify.verify import default_count
from support.random_urdf import Plain, random_robot


def random_chain(folder: Path, seed: int) -> Chain:
    """Return a random robot with at most three moving joints and at most three tips."""
    source = Plain(seed)
    robot = random_robot(source, 3)
    file = folder / f"robot_{seed}.urdf"
    file.write_text(robot.text)
    whole = stiffgen.load_chain(file, base=robot.base, tip=robot.tip)
    names = [str(link.get("name")) for link in ElementTree.fromstring(robot.text).iter("link")]
    links = [name for name in dict.fromkeys(names) if name not in (robot.base, robot.tip)]
    others = source.random.sample(links, min(source.integer(0, 2), len(links)))
    try:
        return stiffgen.load_chain(file, base=robot.base, tip=[robot.tip, *others])
    except stiffgen.StiffgenError:  # a link that is not behind the base, or that no joint moves
        return whole


def alarms(chain: Chain, count: int, seed: int) -> list[Check]:
    """Return the comparisons of CasADi's functions that fail."""
    options = KernelOptions()
    functions = {kernel.qualified_name: function_of_stacks(chain, kernel) for kernel in chain_kernels(chain, options)}
    return [check for check in check_robot(functions, chain, count, seed, options) if not check.passed]


def main() -> int:
    """Run the campaign; return 1 if there is a false alarm."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robots", type=int, default=200, help="random robots [200]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first robot [0]")
    parser.add_argument("--seeds", type=int, default=1, help="seeds of verify per robot [1]")
    parser.add_argument("--samples", type=int, help="states per robot [that of verify]")
    options = parser.parse_args()
    found = 0
    with tempfile.TemporaryDirectory(prefix="stiffgen-alarms-") as folder:
        for number in range(options.seed, options.seed + options.robots):
            chain = random_chain(Path(folder), number)
            for seed in range(options.seeds):
                for check in alarms(chain, options.samples or default_count(chain), seed):
                    found += 1
                    where = f"robot {number}, {chain.dof} joints, {len(chain.tips)} tips, seed {seed}"
                    print(f"{where}: {check.kernel}, {check.oracle}: {check.error:.2e} > {check.bound:.0e}", flush=True)
    print(f"{options.robots} robots, {options.seeds} seeds each: {found} false alarms", flush=True)
    return int(found > 0)


if __name__ == "__main__":
    raise SystemExit(main())
