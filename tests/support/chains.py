# SPDX-License-Identifier: MIT
"""Small robots as text."""

from __future__ import annotations

import xml.etree.ElementTree as ET

INERTIAL = '<inertial><mass value="2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.03"/></inertial>'
ARM = f"""<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="upper">{INERTIAL}</link>
  <link name="lower">{INERTIAL}</link>
  <link name="hand"/>
  <link name="finger">{INERTIAL}</link>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 0.3" rpy="0 1.5707963267948966 0"/><parent link="base"/><child link="upper"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="50" velocity="3"/>
  </joint>
  <joint name="elbow" type="revolute">
    <origin xyz="0.4 0 0"/><parent link="upper"/><child link="lower"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="20" velocity="4"/>
  </joint>
  <joint name="wrist" type="fixed"><origin xyz="0.3 0 0"/><parent link="lower"/><child link="hand"/></joint>
  <joint name="grip" type="prismatic">
    <origin xyz="0 0.05 0"/><parent link="hand"/><child link="finger"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="0.1"/>
  </joint>
</robot>
"""


def replaced(*changes: tuple[str, str]) -> str:
    text = ARM
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def chain_urdf(types: str) -> str:
    """Return the URDF of a chain of joints ("r", "p", or "m" for one that mimics joint 0) about changing axes."""
    text = '<robot name="chain"><link name="l0"/>'
    for k, kind in enumerate(types):
        inertial = (
            '<inertial><origin xyz="0.02 0.01 0.1"/><mass value="1.5"/>'
            '<inertia ixx="0.02" iyy="0.025" izz="0.015" ixy="0.001" ixz="0.002" iyz="0.003"/></inertial>'
        )
        axis = ("0 0 1", "0 1 0", "0.6 0 0.8")[k % 3]
        joint = "prismatic" if kind == "p" else "revolute"
        mimic = '<mimic joint="j0" multiplier="-0.5" offset="0.3"/>' if kind == "m" else ""
        text += (
            f'<link name="l{k + 1}">{inertial}</link><joint name="j{k}" type="{joint}"><parent link="l{k}"/>'
            f'<child link="l{k + 1}"/><origin xyz="0.05 -0.02 0.3" rpy="0.1 0.2 0.3"/><axis xyz="{axis}"/>'
            f'<limit lower="-2" upper="2" effort="10" velocity="1"/>{mimic}</joint>'
        )
    return text + "</robot>"


def child_of(element: ET.Element, tag: str) -> ET.Element:
    """Return the element's first child of that tag, which must be there."""
    found = element.find(tag)
    assert found is not None, tag
    return found
