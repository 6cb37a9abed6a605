# SPDX-License-Identifier: MIT
"""What ``inspect`` says of the chains of a description."""

from __future__ import annotations

from pathlib import Path

import pytest

from stiffgen.cli import main
from stiffgen.cli.console import TextConsole
from stiffgen.cli.survey import survey_tip
from stiffgen.core.errors import ChainError
from stiffgen.core.robot.reader import read_description
from stiffgen.core.robot.selection import select, suggested_tips
from support.chains import ARM, INERTIAL, replaced

LEG = (
    f'<link name="leg">{INERTIAL}</link><joint name="hip" type="revolute"><parent link="base"/><child link="leg"/>'
    "</joint></robot>"
)
FREE = '<link name="world"/><joint name="free" type="{}"><parent link="world"/><child link="base"/></joint></robot>'
OTHER_LIMB = replaced(("</robot>", LEG))


@pytest.fixture
def described(tmp_path: Path):
    def read(text: str):
        (tmp_path / "arm.urdf").write_text(text)
        return read_description(tmp_path / "arm.urdf")

    return read


def test_a_whole_chain_leaves_nothing_out(described):
    survey = survey_tip(described(ARM), "finger")
    assert (survey.base, survey.coordinates) == ("base", ("shoulder", "elbow", "grip"))
    assert (survey.left_out, survey.hindrance) == ((), "")


FRAMES = {
    "hand": ["hand", "finger"],
    "tool0": ["hand", "finger"],
    "robot1_end_effector_link": ["hand", "finger"],
    "left/attachment_site": ["hand", "finger"],
    "panda_flange": ["hand", "finger"],
    "hand_left_eye": ["finger"],
    "lower_hand_camera": ["finger"],
}


@pytest.mark.parametrize("frame", FRAMES)
def test_named_frames_come_before_leaves(described, tmp_path, frame):
    """Survey a hand with two fingers: frames that are named as tips come before the leaves."""
    other = (
        '<link name="thumb"/><joint name="t" type="fixed"><parent link="hand"/><child link="thumb"/></joint></robot>'
    )
    text = replaced(("</robot>", other)).replace('link name="hand"', f'link name="{frame}"')
    description = described(text.replace('link="hand"', f'link="{frame}"'))
    expected = ([frame] if len(FRAMES[frame]) == 2 else []) + ["finger", "thumb"]
    assert suggested_tips(description) == expected
    with pytest.raises(ChainError, match="choose one with --tip: " + ", ".join(expected)):
        select(description)


def test_what_rides_along_and_other_limbs(described):
    survey = survey_tip(described(OTHER_LIMB), "hand")
    assert survey.coordinates == ("shoulder", "elbow")
    assert survey.left_out == (("rides along, held at zero", ("grip",)), ("on other limbs", ("hip",)))
    assert survey_tip(described(OTHER_LIMB), "leg").left_out == (("on other limbs", ("shoulder", "elbow", "grip")),)


def test_a_planar_base_is_left_out(described):
    survey = survey_tip(described(replaced(("</robot>", FREE.format("planar")))), "finger")
    assert (survey.base, len(survey.coordinates), survey.floating) == ("base", 3, False)
    assert survey.left_out == (("above the base, planar", ("free",)),)


def test_a_base_that_floats(described):
    """Survey a robot with a floating joint: the base floats, except with --base or where something moves before it."""
    text = replaced(("</robot>", FREE.format("floating")))
    survey = survey_tip(described(text), "finger")
    assert (survey.base, len(survey.coordinates), survey.floating, survey.left_out) == ("base", 3, True, ())
    stands = survey_tip(described(text), "finger", "base")
    assert not stands.floating and stands.left_out == (("above the base, floating", ("free",)),)
    cart = (
        '<link name="cart"/><joint name="rail" type="prismatic"><parent link="cart"/><child link="world"/>'
        '<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    survey = survey_tip(described(text.replace("</robot>", cart)), "finger")
    assert (survey.base, survey.floating) == ("base", False)
    assert survey.left_out == (("above the base, floating", ("free",)), ("above the base", ("rail",)))


def test_joints_above_a_base(described):
    survey = survey_tip(described(ARM), "finger", "lower")
    assert survey.coordinates == ("grip",)
    assert survey.left_out == (("above the base", ("shoulder", "elbow")),)


def test_mimic_joints_are_no_coordinates(described):
    text = replaced(('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><mimic joint="elbow"/>'))
    assert survey_tip(described(text), "finger").coordinates == ("shoulder", "elbow")
    assert survey_tip(described(text), "hand").left_out == ()


@pytest.mark.parametrize("width", [60, 80, 120])
def test_names_are_whole_in_a_narrow_terminal(width, described, tmp_path, monkeypatch, capsys):
    """Print long names in a narrow terminal: none is cut or broken, as it is typed again behind --tip."""
    long = "left/end_effector_link_of_the_gripper[0]"
    text = replaced(('joint name="elbow"', f'joint name="{long}_joint"')).replace('"hand"', f'"{long}"')
    described(text.replace('"lower"', '"right/forearm_roll_link_with_a_name"'))
    monkeypatch.setattr("stiffgen.cli.inspect.tables", lambda: TextConsole(highlight=False, width=width))
    assert main(["inspect", str(tmp_path / "arm.urdf")]) == 0
    shown = capsys.readouterr().out
    assert "…" not in shown
    for name in (long, f"{long}_joint", "right/forearm_roll_link_with_a_name", "shoulder", "finger"):
        assert name in shown, name


def test_hindrances(described):
    """Survey tips that have no chain: each states why, and what would still be possible."""
    assert survey_tip(described(ARM), "base").hindrance == "no moving joint"
    heavy = survey_tip(described(ARM.replace('izz="0.03"', 'izz="0.5"', 1)), "finger")
    assert heavy.hindrance.startswith("only with --no-masses: link 'upper'") and len(heavy.coordinates) == 3
    bent = survey_tip(described(replaced(('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>'))), "finger")
    assert bent.hindrance.startswith("refused: joint 'elbow'") and bent.coordinates == ()
    for tip, base in (("foot", None), ("finger", "foot")):
        with pytest.raises(ChainError, match="foot"):
            survey_tip(described(ARM), tip, base)


def test_the_command_shows_parents_tips_and_what_is_left_out(tmp_path, capsys):
    """Print the survey of an arm with a leg: joints with their links, coordinates of each tip, and joints left out."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(OTHER_LIMB.replace("</robot>", FREE.format("floating")))
    assert main(["inspect", str(urdf)]) == 0
    lines = capsys.readouterr().out.splitlines()
    words = {line.split(" ")[0]: line for line in lines}
    assert "upper" in words["elbow"] and "lower" in words["elbow"]  # parent and child
    assert "3: shoulder, elbow, grip" in words["finger"] and "base, which floats" in words["finger"]
    assert any("rides along, held at zero: 1 (hip)" in line for line in lines)
    assert main(["inspect", str(urdf), "--tip", "hand"]) == 0
    out = capsys.readouterr().out
    assert "2: shoulder, elbow" in out and "rides along, held at zero: 2 (grip, hip)" in out and "1: hip" not in out
    assert main(["inspect", str(urdf), "--tip", "foot"]) == 2
    assert "foot" in capsys.readouterr().err


@pytest.mark.slow
def test_generate_warns_of_what_is_beside_the_chain(tmp_path, capsys):
    """Misspell an element of another limb: `generate` warns, and `inspect` lists the fault."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(
        OTHER_LIMB.replace('<joint name="hip" type="revolute">', '<joint name="hip" type="revolute"><orgin/>')
    )
    assert main(["generate", str(urdf), "--tip", "finger", "--no-build", "--output", str(tmp_path)]) == 0
    warnings = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    assert len(warnings) == 1
    assert warnings[0].startswith("stiffgen: warning: arm.urdf: without effect on this chain: joint 'hip': <orgin>")
    assert main(["inspect", str(urdf)]) == 1
    assert "did you mean <origin>?" in capsys.readouterr().out
