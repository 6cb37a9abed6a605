# SPDX-License-Identifier: MIT
"""Nothing from a robot file reaches C, CMake, Python, Markdown or a path unescaped."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import numpy as np
import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.core.symbolic.choices import KernelOptions
from support.cuda_host import HostCuda

EVIL = [
    '*/ #error "x"', 'a"""b', "c'''d", "e\\", "${CMAKE_BINARY_DIR}", "{{ n }}{% raw %}", "??/", "ü→日本", "<script>",
    "`rm -rf`", "%s%n", "-->", "\u202e", "../../up", "a" * 5000, "line\nbreak",
]  # fmt: skip


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.slow
@pytest.mark.parametrize("several_tips", [pytest.param(False, marks=pytest.mark.wide), True])
def test_evil_names(several_tips, tmp_path):
    """Give each name of a chain hostile characters: it compiles, imports, and gives the names back."""
    links = [f"{name}#{k}" for k, name in enumerate([*EVIL, "last"])]
    joints = EVIL
    elements = [f"<link name={quoteattr(link)}/>" for link in links]
    for k, joint in enumerate(joints):
        elements.append(
            f'<joint name={quoteattr(joint)} type="{"prismatic" if k % 3 else "revolute"}">'
            f"<parent link={quoteattr(links[k])}/><child link={quoteattr(links[k + 1])}/>"
            '<origin xyz="0.1 0 0.2" rpy="0.1 0.2 0.3"/><axis xyz="0 1 1"/></joint>'
        )
    urdf = tmp_path / "evil *${x}`#.urdf"
    urdf.write_text(f"<robot name={quoteattr(EVIL[0])}>{''.join(elements)}</robot>", encoding="utf-8")
    tips = [links[7], links[-1]] if several_tips else links[-1]
    output = tmp_path / "out"
    few = KernelOptions(kernels=("hybrid.jacobian", "mass_matrix"))  # the controller brings what it calls
    options = {"tip": tips, "lock": {EVIL[3]: 0.1}}
    folder = stiffgen.generate(urdf, output=output, cuda=True, kernels=few.kernels, **options)
    assert [path.name for path in output.iterdir()] == ["error_x"]
    robot = open_robot(folder).module
    names = [joint for joint in joints if joint != EVIL[3]]
    assert list(robot.JOINTS) == names
    assert len(names) == robot.DOF
    assert links[0] == robot.BASE
    if several_tips:
        assert tuple(tips) == robot.TIPS
        assert robot.mass_matrix(np.zeros(robot.DOF)).shape == (robot.DOF, robot.DOF)
    else:
        assert tips == robot.TIP
        assert robot.hybrid.jacobian(np.zeros(robot.DOF)).shape == (6, robot.DOF)
    chain = stiffgen.load_chain(urdf, **options)
    HostCuda(folder / "error_x.cu", "error_x", chain, tmp_path, level="-O0", options=few)  # compiles without a warning
    for path in folder.iterdir():
        if path.suffix in (".c", ".h", ".cu", ".txt", ".md"):
            assert path.read_text(encoding="utf-8").isascii(), path.name
    assert "<script>" not in (folder / "README.md").read_text()
