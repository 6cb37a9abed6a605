# SPDX-License-Identifier: MIT
"""Robots by name, from packages that hold descriptions; the packages here are stand-ins with their layout."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from stiffgen.cli import main
from stiffgen.core.errors import DescriptionError, MissingExtraError, StiffgenError
from stiffgen.core.loading import describe
from stiffgen.core.robot.description import Reading
from support.chains import ARM

TEMPLATE = """<robot name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include
 filename="$(find parts)/part.xacro"/></robot>"""
PART = """<robot><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>
</joint></robot>"""
LIST = """from enum import IntEnum
class Format(IntEnum):
    URDF = 0
    MJCF = 1
    SRDF = 2
class Description:
    def __init__(self, formats, maker=None, license_spdx=None):
        self.formats, self.maker, self.license_spdx = formats, maker, license_spdx
DESCRIPTIONS = {
    "arm_description": Description({Format.URDF, Format.SRDF}, "Maker A", "MIT"),
    "arm_mj_description": Description({Format.MJCF}, "Maker A", "Apache-2.0"),
    "lab_description": Description({Format.URDF}, "Maker B"),
    "far_description": Description({Format.URDF}),
    "poses_description": Description({Format.SRDF}),
}"""


@pytest.fixture
def described(tmp_path, monkeypatch):
    """Install a stand-in for robot_descriptions."""
    package = tmp_path / "robot_descriptions"
    (package / "parts").mkdir(parents=True)
    files = {
        "arm.urdf": ARM,
        "lab.urdf.xacro": TEMPLATE,
        "parts/part.xacro": PART,
        "__init__.py": "",
        "_descriptions.py": LIST,
        "arm_description.py": f"print('Cloning ...')\nURDF_PATH = {str(package / 'arm.urdf')!r}\n",
        "lab_description.py": f"REPOSITORY_PATH = {str(package)!r}\nXACRO_PATH = {str(package / 'lab.urdf.xacro')!r}\n"
        f"XACRO_ARGS = {{'name': 'lab'}}\nXACRO_PACKAGE_PATHS = {{'parts': {str(package / 'parts')!r}}}\n",
        "far_description.py": "raise OSError('Could not resolve host: github.com')\n",
    }
    for name, text in files.items():
        (package / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    # Another test may have looked into a folder of the same second: Python then believes its old listing.
    importlib.invalidate_caches()
    yield package
    for name in [name for name in sys.modules if name.split(".")[0] == "robot_descriptions"]:
        del sys.modules[name]


def test_a_name_stands_for_a_file(described, capsys):
    """Name robots instead of files: the same description, and nothing else on standard output."""
    assert describe("arm").file == describe("arm_description").file == "arm.urdf"
    assert "Cloning" not in capsys.readouterr().out  # standard output holds the result alone
    lab = describe("lab")
    assert (lab.robot, lab.arguments) == ("lab", (("name", "lab"),))
    assert describe("lab", Reading(arguments={"name": "other"})).robot == "other"
    assert main(["inspect", "lab", "name:=mine"]) == 0
    assert "robot mine: 2 links" in capsys.readouterr().out


def test_a_file_comes_before_a_name(described):
    Path("arm").write_text(PART.replace("<robot>", '<robot name="file">'))
    assert describe("arm").robot == "file"
    with pytest.raises(DescriptionError, match="cannot be read"):
        describe("./lab")


def test_unknown_names_and_no_network(described, capsys):
    """Misspell a name or take the network away: refused with a suggestion or what to do."""
    with pytest.raises(DescriptionError, match="did you mean arm"):
        describe("armm")
    with pytest.raises(DescriptionError, match=r"cannot be downloaded .Could not resolve host.*connect to the network"):
        describe("far")
    assert main(["generate", "--robot", "a/b"]) == 2
    with pytest.raises(SystemExit, match="2"):
        main(["generate", "x.urdf", "--robot", "arm"])
    assert "one of the two" in capsys.readouterr().err


def test_robots_lists_name_format_and_licence(described, capsys):
    assert main(["inspect", "ARM", "--list", "known"]) == 0
    out = capsys.readouterr().out
    assert [line.split()[0] for line in out.splitlines()[2:]] == ["arm", "arm_mj"]
    assert "MJCF" in out and "Apache-2.0" in out and "poses" not in out
    assert main(["inspect", "nothing", "--list", "known"]) == 2


@pytest.mark.usefixtures("mjcf_in_this_process")
def test_menagerie(tmp_path, monkeypatch, capsys):
    """Read a robot of Menagerie by its name; the list states its licence."""
    folder = tmp_path / "maker_arm"
    folder.mkdir()
    (folder / "LICENSE").write_text("BSD 3-Clause\n")
    (folder / "scene.xml").write_text('<mujoco><include file="arm.xml"/></mujoco>')
    (folder / "arm.xml").write_text('<mujoco model="arm"><worldbody><body name="b"><joint name="j"/><geom size=".1"/>'
                                    "</body></worldbody></mujoco>")  # fmt: skip
    monkeypatch.setenv("MUJOCO_MENAGERIE_PATH", str(tmp_path))
    assert describe("maker_arm").file == "arm.xml"
    assert main(["inspect", "--list", "known"]) == 0
    assert "BSD 3-Clause" in capsys.readouterr().out


MODEL = """<mujoco model="{}"><worldbody><body name="b"><joint name="j"/><geom size=".1"/></body></worldbody>
</mujoco>"""
REGISTRY = """from pathlib import Path
class Entry:
    def __init__(self, file):
        self.file = file
class Robot:
    license, default_model = "Apache-2.0", "left_hand"
    def __init__(self, name):
        self.name = name
    def path(self, cache=None, progress=print):
        if self.name == "far_hand":
            raise LookupError("no route to host")
        Path({cache!r}, "asked").write_text(self.name)
        return Path({cache!r}, self.name)
    def entry(self, name=None):
        return Entry(f"{{name}}.xml")
def robots(category=None):
    return [Robot("maker_hand"), Robot("far_hand")]
def get(name):
    return next(robot for robot in robots() if robot.name == name)
"""


def hand(folder: Path) -> Path:
    """Write a hand as shadow_hand of Menagerie has it: keyframes beside a left and a right model."""
    folder.mkdir(parents=True)
    (folder / "keyframes.xml").write_text('<mujoco><keyframe><key qpos="0"/></keyframe></mujoco>')
    for side in ("left", "right"):
        (folder / f"{side}_hand.xml").write_text(MODEL.format(side))
        (folder / f"scene_{side}.xml").write_text(f'<mujoco><include file="{side}_hand.xml"/></mujoco>')
    return folder


@pytest.fixture
def menagerie(tmp_path, monkeypatch):
    """Install a stand-in for PyPI's mujoco_menagerie, which lists robots and downloads them into a cache."""
    package, cache = tmp_path / "site" / "mujoco_menagerie", tmp_path / "cache"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(REGISTRY.format(cache=str(cache)))
    hand(cache / "maker_hand")
    monkeypatch.syspath_prepend(package.parent)
    monkeypatch.chdir(tmp_path)
    yield cache
    sys.modules.pop("mujoco_menagerie", None)


@pytest.mark.usefixtures("mjcf_in_this_process")
def test_robots_of_the_package_of_menagerie(menagerie, capsys):
    assert describe("maker_hand").robot == "left"
    assert main(["inspect", "maker", "--list", "known"]) == 0
    assert "Apache-2.0" in capsys.readouterr().out
    with pytest.raises(DescriptionError, match=r"cannot be downloaded \(no route to host\).*MUJOCO_MENAGERIE_PATH"):
        describe("far_hand")


@pytest.mark.usefixtures("mjcf_in_this_process")
def test_a_copy_of_menagerie_comes_before_a_download(menagerie, monkeypatch, tmp_path):
    """Name robots that a local copy has: nothing is downloaded."""
    hand(tmp_path / "copy" / "maker_hand")
    monkeypatch.setenv("MUJOCO_MENAGERIE_PATH", str(tmp_path / "copy"))
    assert describe("maker_hand").robot == "left"
    assert not (menagerie / "asked").exists()
    for other in ("far_hand", "own_hand"):  # a robot that cannot be downloaded, and one that the list lacks
        hand(tmp_path / "copy" / other)
        assert describe(other).robot == "left"
    assert not (menagerie / "asked").exists()


@pytest.mark.slow
@pytest.mark.parametrize("model", ["left_hand", "right_hand", "follower_1.2"])
@pytest.mark.usefixtures("mjcf_in_this_process")
def test_the_default_model_of_a_robot(menagerie, tmp_path, monkeypatch, model):
    """Name a folder with several models: the package's list decides, downloaded or copied."""
    package = tmp_path / "site" / "mujoco_menagerie" / "__init__.py"
    package.write_text(package.read_text().replace("left_hand", model))
    for folder in (menagerie, tmp_path / "copy"):
        if folder != menagerie:
            hand(folder / "maker_hand")
            monkeypatch.setenv("MUJOCO_MENAGERIE_PATH", str(folder))
        (folder / "maker_hand" / f"{model}.xml").write_text(MODEL.format(f"{model} of {folder.name}"))
        assert describe("maker_hand").robot == f"{model} of {folder.name}"


@pytest.mark.slow
@pytest.mark.usefixtures("mjcf_in_this_process")
def test_a_file_of_keyframes_is_no_robot(tmp_path, monkeypatch):
    """Find the model without the list: the file with a body that is no scene."""
    hand(tmp_path / "maker_hand")
    monkeypatch.setenv("MUJOCO_MENAGERIE_PATH", str(tmp_path))
    assert describe("maker_hand").robot == "left"
    for part in ("<asset/><default/>", "<sensor/>", '<keyframe><key qpos="1"/></keyframe><!-- <body> -->'):
        (tmp_path / "maker_hand" / "hand.xml").write_text(f"<mujoco>{part}</mujoco>")
        assert describe("maker_hand").robot == "left"


def test_a_copy_comes_before_robot_descriptions(described, tmp_path, monkeypatch):
    hand(tmp_path / "copy" / "far_description")
    monkeypatch.setenv("MUJOCO_MENAGERIE_PATH", str(tmp_path / "copy"))
    assert describe("far_description").robot == "left"


def test_without_packages_the_remedy_is_named(monkeypatch):
    monkeypatch.setattr("stiffgen.files.names.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match="pip install robot_descriptions"):
        describe("fr3")


def test_names_are_no_paths():
    for text in ("no/such.urdf", "arm.urdf", "", "..", "x" * 5000 + ".urdf"):
        with pytest.raises(StiffgenError) as refusal:
            describe(text)
        assert "robot_descriptions" not in str(refusal.value)
