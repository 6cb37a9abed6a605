# SPDX-License-Identifier: MIT
"""Short form of the comparison of robots: this repository's files, and an MJCF file whose oracle is given another."""

from __future__ import annotations

from pathlib import Path

import pytest

from campaigns import robots_table

ROOT = Path(__file__).resolve().parents[2]
MJCF = """<mujoco model="arm"><worldbody><body name="a" euler="10 20 30"><joint name="one" axis="0 1 1" armature=".1"/>
<geom size="0.1" pos="0.1 0 0"/><body name="b" pos="0.3 0 0.1"><joint name="two" pos="0 0 0.1" ref="20"/>
<geom type="capsule" size="0.05 0.2"/><site name="tip" pos="0 0 {}"/><site name="other"/>
</body></body></worldbody></mujoco>"""

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("file", "chains"), [("urdf/iiwa14.urdf", 1), ("tests/data/solo12.urdf", 4)])
def test_urdf_files_agree(file, chains):
    row = robots_table.check_file(ROOT / file, file)
    assert (row.agreed, row.wrong, row.refused) == (chains, [], [])


def test_mjcf_agrees_and_a_difference_is_seen(tmp_path, monkeypatch):
    """Compare an MJCF file with MuJoCo, then with a link that is 1e-6 m longer, which must be seen."""
    file, other = tmp_path / "arm.xml", tmp_path / "other.xml"
    file.write_text(MJCF.format(0.2))
    other.write_text(MJCF.format(0.200001))
    row = robots_table.check_file(file, "arm.xml")
    assert (row.joints, row.agreed, row.wrong) == ([2], 1, [])
    oracle = robots_table.MujocoChain
    monkeypatch.setattr(robots_table, "MujocoChain", lambda path, *rest: oracle(other, *rest))
    (wrong,) = robots_table.check_file(file, "arm.xml").wrong
    assert "forward_kinematics" in wrong
