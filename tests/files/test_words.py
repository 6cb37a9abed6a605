# SPDX-License-Identifier: MIT
"""Words about other people's files: what is left out, names as they are written, encodings, numbers, arguments."""

from __future__ import annotations

import re
import shlex
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.cli.survey import survey_tip
from stiffgen.core.described import in_python
from stiffgen.core.errors import DescriptionError, InertiaWarning, StiffgenError, shell_word
from stiffgen.core.loading import describe, read_chain
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.options import GenerationOptions
from stiffgen.core.robot.description import Reading
from stiffgen.core.verify.folder.files import check_urdf
from support.chains import ARM, INERTIAL, replaced

LIMIT = 'lower="-1" upper="1"'
AXIS = '<axis xyz="0 1 0"/>'


def written(folder: Path, text: str | bytes, name: str = "arm.urdf") -> Path:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder / name


REMARKS = {
    "soft limits": ('<safety_controller soft_lower_limit="-0.5" soft_upper_limit="0.4"/>', "elbow.*-0.5 to 0.4"),
    "one soft limit": ('<safety_controller soft_upper_limit="0.4"/>', "'elbow': soft limits 0 to 0.4"),
    "soft limits below zero": (
        '<safety_controller soft_lower_limit="-0.9" soft_upper_limit="-0.2"/>',
        "'elbow': soft limits -0.9 to -0.2",
    ),
    "little damping": ('<dynamics damping="1e-4" friction="0"/>', "1 joint has damping, which .*: elbow"),
    "little friction": ('<dynamics friction="0.01"/>', "1 joint has dry friction, .*: elbow"),
    "damping": ('<dynamics damping="0.7"/>', "1 joint has damping, which .*: elbow"),
    "friction": ('<dynamics damping="0" friction="3"/>', "1 joint has dry friction, .*: elbow"),
}  # fmt: skip


@pytest.mark.parametrize("name", REMARKS)
def test_what_a_urdf_has_and_the_functions_do_not_is_named(name: str, tmp_path: Path) -> None:
    added, words = REMARKS[name]
    (remark,) = describe(written(tmp_path, replaced((AXIS, AXIS + added)))).remarks
    assert re.search(words, remark)


def test_soft_limits_that_are_the_limits_are_no_remark(tmp_path: Path) -> None:
    """Makers repeat the limits; nothing is left out then."""
    soft = '<safety_controller soft_lower_limit="-1" soft_upper_limit="1"/>'
    assert LIMIT == 'lower="-1" upper="1"'
    assert describe(written(tmp_path, replaced((AXIS, AXIS + soft)))).remarks == ()


def test_the_joints_with_dynamics_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Damping and friction apart; inspect prints both."""
    both, one = '<dynamics damping="0.7" friction="2"/>', '<dynamics damping="0.1"/>'
    text = replaced((AXIS, AXIS + both), ('<axis xyz="1 0 0"/>', f'<axis xyz="1 0 0"/>{one}'))
    remarks = describe(written(tmp_path, text)).remarks
    assert [each.split(", which")[0] for each in remarks] == ["2 joints have damping", "1 joint has dry friction"]
    assert [each.rsplit(": ", 1)[1] for each in remarks] == ["elbow, grip", "elbow"]
    assert main(["inspect", str(tmp_path / "arm.urdf")]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert all(each in shown for each in remarks)


def test_nothing_is_named_without_a_reason(tmp_path: Path) -> None:
    zero = '<dynamics damping="0" friction="0.0"/><safety_controller k_velocity="10"/>'
    assert describe(written(tmp_path, replaced((AXIS, AXIS + zero)))).remarks == ()


DRAKE = '<drake:rotor_inertia value="0.0002"/>{}'
ROTORS = {
    "in a transmission": ('<transmission><joint name="elbow"/><actuator name="m">{}</actuator></transmission>', 100),
    "without a ratio": ('<transmission><joint name="elbow"/><actuator name="m">{}</actuator></transmission>', None),
    "beside an actuator": ('<transmission><joint name="elbow"/><actuator name="m"/>{}</transmission>', -50),
}


@pytest.mark.parametrize("namespace", ["", ' xmlns:drake="http://drake.mit.edu"'])
@pytest.mark.parametrize("name", ROTORS)
def test_rotors_are_motor_inertias(name: str, namespace: str, tmp_path: Path) -> None:
    """Drake's reflected inertia: rotor times the square of the gear ratio."""
    place, ratio = ROTORS[name]
    rotor = DRAKE.format("" if ratio is None else f'<drake:gear_ratio value="{ratio}"/>')
    text = replaced(("</robot>", place.format(rotor) + "</robot>"), ('name="arm"', f'name="arm"{namespace}'))
    chain = stiffgen.load_chain(written(tmp_path, text))
    assert [c.motor_inertia for c in chain.coordinates] == [0, pytest.approx(2e-4 * (ratio or 1) ** 2), 0]
    expected = f"1 joint has rotors, used as motor inertia: elbow ({2e-4 * (ratio or 1) ** 2:g} kg m^2)"
    assert describe(tmp_path / "arm.urdf").remarks == (expected,)


REFUSED_ROTORS = {
    "no number": (
        "elbow",
        'value="2e-4 kg"',
        "the rotor inertia 2e-4 kg with gear ratio 100 is not a number of at least 0",
    ),
    "negative": ("elbow", 'value="-2e-4"', "the rotor inertia -2e-4 .* is not a number of at least 0"),
    "no value": ("elbow", 'inertia="2e-4"', "the rotor inertia None .* is not a number of at least 0"),
    "not finite": ("elbow", 'value="inf"', "the rotor inertia inf .* is not a number of at least 0"),
    "two joints": ('elbow"/><joint name="grip', 'value="2e-4"', "the rotor inertia 2e-4 .* belongs to no single joint"),
    "of no joint": ("elbo", 'value="2e-4"', "the rotor inertia 2e-4 .* belongs to no single joint"),
}


@pytest.mark.parametrize("name", REFUSED_ROTORS)
def test_rotors_that_cannot_be_used_are_named(name: str, tmp_path: Path) -> None:
    """State rotors that cannot be used: a remark says why, and the inertia stays 0."""
    joint, value, words = REFUSED_ROTORS[name]
    rotor = (
        f'<transmission name="t"><joint name="{joint}"/><drake:rotor_inertia {value}/><drake:gear_ratio value="100"/>'
    )
    description = describe(written(tmp_path, replaced(("</robot>", f"{rotor}</transmission></robot>"))))
    assert [joint.motor_inertia for joint in description.joints.values()] == [0] * 4
    (remark,) = description.remarks
    assert re.search(f"transmission 't': {words}, and is not used", remark)


NAMES = ["關節/1", "right_finger[0]/base", "Übung", "DFKI_Motor_0.axis", "base link", "[bold]red[/bold]", "a*b`c|d"]


@pytest.mark.parametrize("name", NAMES)
def test_names_are_shown_as_written_and_accepted_back(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Print unusual names: shown as in the file, and accepted as options."""
    text = ARM.replace('"hand"', f'"{name}"').replace('"elbow"', f'"{name} joint"')
    file = written(tmp_path, text)
    assert main(["inspect", str(file), "--tip", name]) == 0
    shown = capsys.readouterr().out
    assert shown.count(name) >= 3 and f"{name} joint" in shown
    assert stiffgen.load_chain(file, tip=name, lock={f"{name} joint": 0.1}).tip == name


LATIN = ARM.replace('"arm"', '"Übung"').encode("latin-1")
ENCODINGS = {
    "Latin-1, undeclared": (LATIN, "no UTF-8 text .byte 0xdc at .*save it as UTF-8.*encoding="),
    "UTF-16 without a mark, big": (ARM.split("?>")[1].encode("utf-16-be"), "UTF-16 text without a .* as UTF-8"),
    "UTF-16 without a mark, little": (LATIN.decode("latin-1").split("?>")[1].encode("utf-16-le"), "UTF-16 .* as UTF-8"),
    "MJCF in Latin-1": (
        '<mujoco model="Übung"><worldbody/></mujoco>'.encode("latin-1"),
        r"a name is no UTF-8 text \(byte 0xdc\); save the file, and those that it includes, as UTF-8",
    ),
    "MJCF in UTF-16": ("<mujoco><worldbody/></mujoco>".encode("utf-16"), "MJCF.*save it as UTF-8"),
}  # fmt: skip


def test_the_remedy_of_a_template_in_utf_16(tmp_path: Path) -> None:
    with pytest.raises(StiffgenError, match=r"arm.xacro.* is not UTF-8 text .*; save it as UTF-8"):
        describe(written(tmp_path, TEMPLATE.encode("utf-16"), "arm.xacro"))


@pytest.mark.parametrize("name", ENCODINGS)
def test_the_remedy_of_an_encoding(name: str, tmp_path: Path) -> None:
    data, words = ENCODINGS[name]
    with pytest.raises(StiffgenError, match=words):
        describe(written(tmp_path, data))


def test_declared_encodings_are_read(tmp_path: Path) -> None:
    text = ARM.replace('"arm"', '"Übung"').replace("?>", ' encoding="{}"?>')
    for encoding in ("iso-8859-1", "utf-16", "utf-16-le"):
        assert describe(written(tmp_path, text.format(encoding).encode(encoding))).robot == "Übung"


COMMAS = {
    'xyz="0,4 0 0"': "'0,4' is not a finite decimal number; write 0.4",
    'xyz="-1,5e-3 0 0"': "write -1.5e-3",
    'xyz="0.4, 0, 0"': "'0.4,' is not a finite decimal number; write 0.4",
    'xyz="0.4,0,0"': "separate numbers by spaces, without commas",
    'xyz="0.4; 0; 0"': "write 0.4",
}


@pytest.mark.parametrize(
    ("old", "new", "remedy", "obeyed"),
    [
        (LIMIT, 'lower="0.5"', "has no upper, .* its range is 0.5 to 0; add upper", 'lower="0.5" upper="1"'),
        (LIMIT, 'upper="-0.5"', "has no lower, .*; add lower", 'lower="-1" upper="-0.5"'),
        (LIMIT, 'lower="1" upper="-1"', "lower limit 1 is above upper limit -1; swap them, or correct", LIMIT),
        (LIMIT, 'lower="-1e400" upper="1"', "double precision; write -inf for no limit", 'lower="-inf" upper="1"'),
        (LIMIT, 'lower="-1" upper="1e400"', "'1e400' is .*; write inf for no limit", 'lower="-1" upper="inf"'),
        ('effort="20"', 'effort="-20"', "is negative; write .* or write 0 if it has none", 'effort="0"'),
        ('xyz="0.4 0 0"', 'xyz="1e400 0 0"', r"beyond 1e\+12; give metres", 'xyz="0.4 0 0"'),
        ('mass value="2"', 'mass value="1,500"', "write 1.500, or 1500 for thousands", 'mass value="1500"'),
        ('xyz="0.4 0 0"', 'xyz="0.4m 0 0"', "write a number like 0.25, without a unit", 'xyz="0.4 0 0"'),
        (AXIS, '<axis xyz="0 0 0"/>', "no direction; give the one in which it turns or slides", AXIS),
        (AXIS, "<axis/>", "has no xyz; add the direction in which it turns or slides", AXIS),
        ('<robot ', '<robot version="1.3" ', "newer than 1.2, .*; save it as URDF 1.2", '<robot version="1.2" '),
    ],
)  # fmt: skip
def test_a_remedy_that_is_obeyed_does_no_harm(old: str, new: str, remedy: str, obeyed: str, tmp_path: Path) -> None:
    """Obey the remedy of a refusal: the file is read afterwards."""
    with pytest.raises(DescriptionError, match=remedy):
        stiffgen.load_chain(written(tmp_path, replaced((old, new))), tip="hand")
    assert stiffgen.load_chain(written(tmp_path, replaced((old, obeyed))), tip="hand").dof == 2


def test_a_body_without_mass_is_left_out_by_its_remedy(tmp_path: Path) -> None:
    """Without <inertial>, as the remedy was before, gravity is that of a lighter arm."""
    file = written(tmp_path, replaced(('<mass value="2"/>', "")))
    with pytest.raises(DescriptionError, match=r"has no <mass>; add it, or leave all masses out \(masses=False\)"):
        stiffgen.load_chain(file, tip="hand")
    assert stiffgen.load_chain(file, tip="hand", masses=False).dof == 2


@pytest.mark.parametrize("text", COMMAS)
def test_commas_have_a_remedy(text: str, tmp_path: Path) -> None:
    with pytest.raises(StiffgenError, match=re.escape(COMMAS[text])):
        stiffgen.load_chain(written(tmp_path, replaced(('xyz="0.4 0 0"', text))))


MODEL = '<mujoco><worldbody><body name="b"><joint name="j"/><geom size=".1"/></body></worldbody></mujoco>'
UNLIMITED = {
    "a hinge": '<joint name="j"/>',
    "a slide": '<joint name="j" type="slide" axis="1 0 0"/>',
    "a range without force": '<joint name="j" range="-90 90"/>',
}
FIRST, *OTHERS = UNLIMITED


@pytest.mark.slow
@pytest.mark.parametrize("name", [FIRST, *(pytest.param(each, marks=pytest.mark.wide) for each in OTHERS)])
@pytest.mark.usefixtures("mjcf_in_this_process")
def test_mjcf_files_are_not_told_to_edit_limits(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Leave limits of an MJCF model out: the words name its own attribute, not URDF's <limit>."""
    file = written(tmp_path, MODEL.replace('<joint name="j"/>', UNLIMITED[name]), "arm.xml")
    quiet = ["--no-build", "--output", str(tmp_path / "out")]
    for command in (
        ["inspect", str(file)],
        ["generate", str(file), *quiet],
        ["new", str(file), *quiet[:-1], str(tmp_path / "p")],
    ):
        assert main(command) == 0
        said = "".join(capsys.readouterr())
        assert "<limit>" not in said
        assert "MJCF has none" in said and 'actuatorfrcrange="..." to joint j' in said


@pytest.mark.slow
def test_a_chain_without_reach(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The tip lies on the only axis: the range of positions is 0, which the bounds took for unknown."""
    file = written(tmp_path, MODEL, "arm.xml")
    assert main(["generate", str(file), "--no-build", "--output", str(tmp_path)]) == 0


def test_load_speaks_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse in load(): the remedies are Python arguments, not options of the command."""
    monkeypatch.setenv("STIFFGEN_CACHE", str(tmp_path / "cache"))
    thumb = f'<link name="t">{INERTIAL}</link><joint name="tj" type="revolute"><parent link="hand"/><child link="t"/>'
    file = written(tmp_path, replaced(("</robot>", f"{thumb}</joint></robot>")))
    with pytest.raises(StiffgenError, match=r"choose one with tip=.*hand, finger, t") as refusal:
        stiffgen.load(file)
    assert len(traceback.extract_tb(refusal.value.__traceback__)) == 2
    impossible = written(tmp_path, replaced(('ixx="0.02"', 'ixx="2"')))
    with pytest.raises(StiffgenError, match=r"accept_inertia=\['upper'\]\), or .*\(masses=False\)") as refusal:
        stiffgen.load(impossible)
    assert "--" not in str(refusal.value) and refusal.value.__cause__ is None
    with pytest.raises(StiffgenError, match=r"accept_inertia=\['upper arm'\]\), or .*\(masses=False\)"):
        stiffgen.load(written(tmp_path, impossible.read_text().replace('"upper"', '"upper arm"')))


LEAF = '<link name="t"/><joint name="tj" type="fixed"><parent link="upper"/><child link="t"/></joint>'
REFUSED: dict[str, tuple[str, str, dict[str, Any], str]] = {
    "an inertia": ('ixx="0.02"', 'ixx="2"', {}, r"accept it \(accept_inertia=\['upper'\]\), or .*\(masses=False\)"),
    "another name": ('ixx="0.02"', 'ixx="2"', {"accept_inertia": "x"}, r"\n  accept_inertia=\['x'\]: is no"),
    "an element": ("<limit ", "<limitt/><limit ", {}, r"\(if not: ignore=\['limitt'\]\)"),
    "a tip": ("</robot>", f"{LEAF}</robot>", {}, r"choose one with tip=\.\.\.: "),
    "a tool": ("", "", {"tool": stiffgen.Tool(mass=-1.0)}, r"tool=Tool\(mass=-1\) is negative"),
    "a folder": ("", "", {"package_path": ["/no/ws"]}, r"^arm.urdf: package_path=\['/no/ws'\]: does not exist$"),
    "a loop": ("", "", {"loop": ["a=b"]}, r"^loop=\.\.\. a=b: is not LINK"),
    "a motor": ("", "", {"actuated": "x"}, r"actuated=\.\.\. names the motors .* add close_loops=True"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("function", [stiffgen.load_chain, stiffgen.generate])
def test_python_speaks_python(function: Callable[..., Any], name: str, tmp_path: Path) -> None:
    """Refuse in load_chain() and generate(): the remedies are Python arguments."""
    old, new, options, words = REFUSED[name]
    file = written(tmp_path, replaced((old, new)) if old else ARM)
    more = {} if function is stiffgen.load_chain else {"output": tmp_path, "build": False}
    with pytest.raises(StiffgenError, match=words) as refusal:
        function(file, **options, **more)
    said = [str(refusal.value), *getattr(refusal.value, "problems", ()), getattr(refusal.value, "full", "")]
    assert not any("--" in each for each in said)


def test_options_of_generation_speak_python(tmp_path: Path) -> None:
    """Refuse options of generate(): the words name Python arguments."""
    file = written(tmp_path, ARM)
    for options, words in (
        ({"scalar": "half"}, r"^scalar='half': is not one of"),
        ({"scalar": "float", "derivatives": True}, r"does not go with derivatives=True, which .* with another name="),
        ({"cuda": True, "batches": False}, r"^cuda=True is made from the batches, which batches=False omits"),
        ({"kernels": ("nonsense",)}, r"kernels='nonsense': this robot has no such group"),
        ({"output": file}, r"choose another output="),
    ):
        with pytest.raises(StiffgenError, match=words) as refusal:
            stiffgen.generate(file, **{"output": tmp_path, "build": False} | options)  # type: ignore[arg-type]
        assert "--" not in str(refusal.value)


RECORDS: dict[str, tuple[type, dict[str, Any], str]] = {
    "axes": (stiffgen.Placement, {"rotation_axes": "flange"}, "^placement rotation_axes=flange: axes are"),
    "no number": (stiffgen.Placement, {"centre": (0, 0, float("nan"))}, "^placement centre: must be three finite"),
    "two numbers": (stiffgen.Placement, {"centre": (0, 0)}, "^placement centre: must be three finite"),
    "a range": (Ranges, {"force": -1}, "^range force=-1: must be a positive number$"),
}


@pytest.mark.parametrize("name", RECORDS)
def test_records_of_options_are_refused_without_flags(name: str) -> None:
    record, fields, words = RECORDS[name]
    with pytest.raises(StiffgenError, match=words):
        record(**fields)


def test_the_command_line_keeps_its_own_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse at the command line: options, not Python arguments, also where verify reads the file again."""
    file = written(tmp_path, replaced(('ixx="0.02"', 'ixx="2"')))
    for words in (
        ["generate", str(file)],
        ["new", str(file), "--output", str(tmp_path / "p"), "--controller", "spring"],
    ):
        assert main(words) == 2
        assert "(--accept-inertia upper)" in " ".join(capsys.readouterr().err.split())
    with pytest.raises(StiffgenError, match=r"\(--accept-inertia upper\)"):
        check_urdf(stiffgen.load_chain(written(tmp_path, ARM, "fine.urdf")), file)


def test_a_remedy_for_python_can_be_evaluated() -> None:
    for name in ("upper", "upper arm", "it's", 'a "b"', "arm(1)", "x" * 300, "a\\b"):
        text = in_python(f"accept it (--accept-inertia {shell_word(name)}), or", GenerationOptions)
        call = text.removeprefix("accept it (").removesuffix("), or")
        assert eval(f"dict({call})") == {"accept_inertia": [name]}


LONG = "left_arm_" + "_".join(f"segment_{k}" for k in range(18))  # 185 characters


def test_names_to_be_copied_are_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Print long names in remedies, lists and sentences: whole, up to their end."""
    impossible = replaced(('ixx="0.02"', 'ixx="2"')).replace('"upper"', f'"{LONG}"')
    file = written(tmp_path, impossible)
    with pytest.raises(StiffgenError, match=rf"\(accept_inertia=\['{LONG}'\]\), or .*\(masses=False\)$"):
        stiffgen.load_chain(file)
    assert main(["inspect", str(file)]) == 1
    shown = "".join(capsys.readouterr().out.split())
    assert f"only with --no-masses: link '{LONG}'".replace(" ", "") in shown
    assert shown.count(f"(--accept-inertia{LONG}),orleaveallmassesout(--no-masses)") >= 1
    (survey,) = (each for each in (survey_tip(describe(file), tip) for tip in describe(file).leaves) if each.hindrance)
    assert survey.hindrance.endswith(f"(--accept-inertia {LONG}), or leave all masses out (--no-masses)")
    leaf = f'<link name="{LONG}"/><joint name="tj" type="fixed"><parent link="upper"/><child link="{LONG}"/></joint>'
    with pytest.raises(StiffgenError, match=rf"choose one with tip=.*{LONG}"):
        stiffgen.load_chain(written(tmp_path, replaced(("</robot>", f"{leaf}</robot>"))))
    floating = replaced(("</robot>", "</robot>")).replace('"upper"', f'"{LONG}"').replace("revolute", "planar", 1)
    with pytest.raises(StiffgenError, match=rf"choose a base behind it: base='{LONG}'$"):
        stiffgen.load_chain(written(tmp_path, floating))
    element = replaced(("<limit ", f'<limit {LONG[:-1]}="1" lowe="0" '))
    assert any("--ignore lowe" in each.text for each in describe(written(tmp_path, element)).problems)


@pytest.mark.parametrize("kind", ["urdf", "xacro", "mjcf"])
@pytest.mark.parametrize("folder", ["missing", "arm.file", ""])
def test_a_package_path_that_is_no_folder(kind: str, folder: str, tmp_path: Path) -> None:
    """Give a package path that is no folder: refused, even if the file needs no package."""
    text = {"urdf": ARM, "mjcf": MODEL, "xacro": '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro"/>'}[kind]
    file = written(tmp_path, text, "arm.xacro" if kind == "xacro" else "arm.file")
    written(tmp_path, text, "arm.file")
    path = str(tmp_path / folder) if folder else ""
    fault = {"missing": "does not exist", "arm.file": "is not a folder", "": "is empty"}[folder]
    with pytest.raises(DescriptionError, match=fault) as refusal:
        describe(file, Reading(package_path=[path]))
    assert str(refusal.value).startswith(f"{file.name}: --package-path") and "\n" not in str(refusal.value)


@pytest.mark.parametrize("accepted", ["all", ["upper"], ("upper", "lower")])
def test_load_takes_inertias_that_the_user_accepts(
    accepted: str | list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Accept the inertia of 'upper' in load(): taken, and the robot is read."""
    monkeypatch.setenv("STIFFGEN_CACHE", str(tmp_path / "cache"))
    chains = []

    def generate(file: Path, options: GenerationOptions) -> None:
        """Read the chain, and stop before a folder is written."""
        chains.append(read_chain(file, options))
        raise StiffgenError("enough")

    monkeypatch.setattr("stiffgen.files.cache.generate_folder", generate)
    file = written(tmp_path, replaced(('ixx="0.02"', 'ixx="2"')))
    with pytest.warns(InertiaWarning), pytest.raises(StiffgenError, match="enough"):
        stiffgen.load(file, accept_inertia=accepted)
    assert [each.link for each in chains[0].accepted] == ["upper"]


@pytest.mark.parametrize("value", ["all", "spin", Path("/ws")])
def test_a_word_in_place_of_a_list_is_its_only_value(value: str | Path) -> None:
    reading = Reading(package_path=value, ignore=str(value), accept_inertia=str(value))  # type: ignore[arg-type]
    assert (reading.package_path, reading.ignore, reading.accept_inertia) == ((value,), (str(value),), (str(value),))


@pytest.mark.parametrize("name", ["upper arm", "arm(1)", "arm[0]", "it's"])
def test_a_remedy_can_be_typed(name: str, tmp_path: Path) -> None:
    """The option of the refusal is accepted by the shell as one word, and names the link."""
    text = replaced(('ixx="0.02"', 'ixx="2"')).replace('"upper"', f'"{name}"')
    (problem,) = describe(written(tmp_path, text)).problems
    option = problem.text.split("accept it (", 1)[1].split("), or leave", 1)[0]
    assert shlex.split(option) == ["--accept-inertia", name]


def test_a_folder_that_does_not_exist(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    template = written(tmp_path, '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"/>', "arm.xacro")
    missing = tmp_path / "missing"
    for command in (["inspect", str(template), "--package-path", str(missing)], ["verify", str(missing)]):
        assert main(command) == 2
        assert re.search(r"missing: does not exist", " ".join(capsys.readouterr().err.split()))


TEMPLATE = """<robot name="$(arg type)_$(arg maker)" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="dof" default=""/>
<xacro:arg name="side" default="left"/>
<xacro:include filename="$(dirname)/$(arg dof)dof.xacro"/></robot>"""
PART = f"<robot>{ARM.split('?>')[1].split('>', 1)[1]}"


def test_arguments_of_a_template(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Leave arguments of a template out: all that are missing are named at once."""
    file = written(tmp_path, TEMPLATE, "arm.xacro")
    written(tmp_path, PART, "6dof.xacro")
    with pytest.raises(StiffgenError, match=r"needs values for its arguments 'type', 'maker'; add type:=VALUE maker:="):
        describe(file)
    with pytest.raises(StiffgenError, match=r"needs a value for its argument 'dof', which is empty.*; add dof:=VALUE"):
        describe(file, Reading(arguments={"type": "a", "maker": "b"}))
    for given, missing in (({"type": "a"}, ["maker"]), ({"maker": "b"}, ["type"]), ({"dof": "6"}, ["type", "maker"])):
        with pytest.raises(StiffgenError, match=f"add {':=VALUE '.join(missing)}:=VALUE$"):
            describe(file, Reading(arguments=given))
    assert main(["inspect", str(file), "dof:=6", "type:=a", "maker:=b"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert (
        "arguments of the template, with defaults: dof:=6 (given), side:=left, type:=a (given), maker:=b (given)"
        in shown
    )


EMPTY = {
    "a folder of an include": '<xacro:include filename="$(dirname)/$(arg model)/macro.xacro"/>',
    "an include by an expression": "<xacro:include filename=\"${'arms/' + '$(arg model)' + '/macro.xacro'}\" ns='m'/>",
    "a file of numbers": "<xacro:property name='x' value=\"${xacro.load_yaml('$(dirname)/$(arg model).yaml')}\"/>${x}",
    "a condition": '<xacro:if value="$(arg model)"><link name="b"/></xacro:if>',
    "an expression": '<xacro:if value="${$(arg model) > 3}"><link name="b"/></xacro:if>',
}


@pytest.mark.parametrize("place", EMPTY)
def test_an_empty_argument_is_named_wherever_it_is_used(place: str, tmp_path: Path) -> None:
    """Use an empty argument in different places: the refusal names it each time."""
    declared = '<xacro:arg name="model" default=""/><xacro:arg name="prefix" default=""/>'
    other = '<xacro:include filename="$(dirname)/$(arg prefix)part.xacro"/>'
    head = '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    written(tmp_path, "<robot/>", "part.xacro")
    file = written(tmp_path, f'{head}{declared}{other}<link name="a"/>{EMPTY[place]}</robot>', "arm.xacro")
    words = r"needs a value for its argument 'model', which is empty: .*; add model:=VALUE$"
    with pytest.raises(StiffgenError, match=words):
        describe(file)


def test_a_missing_file_is_no_fault_of_an_empty_argument(tmp_path: Path) -> None:
    file = written(tmp_path, TEMPLATE.replace("$(arg dof)dof", "$(arg side)").replace("$(arg type)_$(arg maker)", "a"),
                   "arm.xacro")  # fmt: skip
    with pytest.raises(StiffgenError, match=r"cannot read '.*left.xacro' .*; correct the path or add the file"):
        describe(file)
