# SPDX-License-Identifier: MIT
"""Search of a template's packages: each place against each later one, and never the working folder."""

from __future__ import annotations

import os
import re
from itertools import combinations
from pathlib import Path

import pytest

from stiffgen.core.errors import StiffgenError
from stiffgen.core.loading import describe
from stiffgen.core.robot.description import Reading
from stiffgen.files import packages
from stiffgen.files.packages import PackageError, Packages
from support.project import ROOT

XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
PACKAGE = "<package format='3'><!-- <name>no</name> --><name>{}</name><author>parts</author></package>"
PLACES = {  # in the order of the search
    "--package-path": "named/parts_of_another_name",
    "own package": "above/it/ws/src/arm",
    "beside": "above/it/ws/src/parts",
    "beside, one folder deeper": "above/it/ws/src/repository/parts",
    "below the folder above": "above/it/ws/others/parts",
    "ROS_PACKAGE_PATH": "ros/repository/parts",
    "AMENT_PREFIX_PATH": "ament/share/parts",
}


def package(folder: Path, name: str = "parts") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "package.xml").write_text(PACKAGE.format(name))
    return folder


@pytest.fixture
def template(tmp_path, monkeypatch):
    """Return a template in above/it/ws/src/arm/urdf; the working folder holds packages, too."""
    package(tmp_path / "cwd" / "parts")
    package(tmp_path / "cwd")
    (tmp_path / "named").mkdir()
    (tmp_path / "ros").mkdir()
    (tmp_path / "ament").mkdir()
    monkeypatch.chdir(tmp_path / "cwd")
    monkeypatch.setenv("ROS_PACKAGE_PATH", os.pathsep.join(["", ".", "parts", str(tmp_path / "ros")]))
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(["", ".", str(tmp_path / "ament")]))
    package(tmp_path / "above" / "it" / "ws" / "src" / "arm", "arm")
    file = tmp_path / "above" / "it" / "ws" / "src" / "arm" / "urdf" / "arm.xacro"
    file.parent.mkdir()
    file.touch()
    return file


def found(template: Path, root: Path) -> str:
    name = Packages(template, [root / "named"], os.environ).find("parts")
    return Path(name).relative_to(root).as_posix()


@pytest.mark.parametrize("pair", list(combinations(PLACES, 2)), ids=" before ".join)
def test_first_place_wins(tmp_path, template, pair):
    places = [PLACES[each] for each in pair]
    for place in reversed(places):
        package(tmp_path / place)
    assert found(template, tmp_path) == places[0]


STATED = {  # words of docs/robots.md, in the order of PLACES
    "--package-path": "--package-path",
    "own package": "the template's own package",
    "beside": "packages beside it",
    "below the folder above": "below each of the four folders above it",
    "ROS_PACKAGE_PATH": "ROS_PACKAGE_PATH",
    "AMENT_PREFIX_PATH": "AMENT_PREFIX_PATH",
}


def test_the_page_states_the_order_of_the_search():
    """Compare the page's order of places with the code's and the module's docstring."""
    page = (ROOT / "docs" / "robots.md").read_text()
    part = re.search(r"searches for the name in `package.xml`, in this order:\n(.*?)\n- ", page, re.DOTALL)[1]
    numbers = re.findall(r"(?m)^  (\d)\. ", part)
    assert numbers == ["1", "2", "3", "4"]
    for text, names in ((part, STATED), (packages.__doc__, [each for each in STATED if "above" not in each])):
        places = [" ".join(text.split()).index(STATED[each]) for each in names]
        assert places == sorted(places) and len(set(places)) == len(places)
    assert [each for each in PLACES if each in STATED] == list(STATED)
    assert "The working folder has no part in it" in part and "The working folder has no part" in packages.__doc__
    assert "Two packages of one name in one place are refused" in part


@pytest.mark.parametrize("place", PLACES)
def test_each_place_alone(tmp_path, template, place):
    package(tmp_path / PLACES[place])
    assert found(template, tmp_path) == PLACES[place]


@pytest.mark.parametrize("place", ["named", "named/repository/parts_2", "named/a/b/c/parts"])
def test_a_named_folder_is_searched_to_its_packages(tmp_path, template, place):
    """The folder is the package, or holds it at some depth, under whatever name."""
    package(tmp_path / place)
    assert found(template, tmp_path) == place


def test_the_working_folder_is_never_searched(tmp_path, template):
    with pytest.raises(PackageError, match="'parts', which is not found"):
        found(template, tmp_path)


@pytest.mark.parametrize("place", ["--package-path", "beside", "beside, one folder deeper", "ROS_PACKAGE_PATH"])
def test_two_of_a_name_in_a_place_are_refused(tmp_path, template, place):
    first = package(tmp_path / PLACES[place])
    second = package(first.with_name("copy"))
    with pytest.raises(PackageError, match="there are two") as refusal:
        found(template, tmp_path)
    assert str(first) in str(refusal.value) and str(second) in str(refusal.value)


def test_names_are_those_of_package_xml(tmp_path, template):
    """Name packages by folder and by package.xml: the folder counts only where the user names the place."""
    package(tmp_path / "named" / "parts", "another")
    with pytest.raises(PackageError):
        found(template, tmp_path)
    package(tmp_path / "named" / "parts" / "parts")  # inside of a package of another name: no package of its own
    with pytest.raises(PackageError):
        found(template, tmp_path)
    (tmp_path / "named" / "parts" / "package.xml").unlink()
    assert found(template, tmp_path) == "named/parts/parts"
    (tmp_path / "named" / "parts" / "parts" / "package.xml").unlink()
    assert found(template, tmp_path) == "named/parts"


@pytest.mark.parametrize("marker", ["COLCON_IGNORE", "CATKIN_IGNORE", "AMENT_IGNORE"])
def test_marked_and_hidden_folders_hold_no_packages(tmp_path, template, marker):
    (package(tmp_path / "above" / "it" / "ws" / "src" / "build" / "parts").parent / marker).touch()
    package(tmp_path / "above" / "it" / "ws" / "src" / ".git" / "parts")
    with pytest.raises(PackageError):
        found(template, tmp_path)


def test_search_ends_before_home_and_temporary_folders(tmp_path, template, monkeypatch):
    """Search a package upwards: folders that others can write to, and HOME, end the search."""
    package(tmp_path / "above" / "it" / "ws" / "others" / "parts")
    assert found(template, tmp_path) == "above/it/ws/others/parts"
    (tmp_path / "above" / "it" / "ws").chmod(0o1777)
    with pytest.raises(PackageError):
        found(template, tmp_path)
    (tmp_path / "above" / "it" / "ws").chmod(0o755)
    monkeypatch.setenv("HOME", str(tmp_path / "above" / "it" / "ws"))
    with pytest.raises(PackageError):
        found(template, tmp_path)


@pytest.mark.parametrize("kind", ["pipe", "folder", "large", "no name"])
def test_what_is_no_package_xml_is_passed_over(tmp_path, template, kind):
    """Put pipes, folders and large files in place of package.xml: passed over, without waiting."""
    folder = package(tmp_path / "above" / "it" / "ws" / "src" / "a")
    (folder / "package.xml").unlink()
    if kind == "pipe":
        os.mkfifo(folder / "package.xml")
    elif kind == "folder":
        (folder / "package.xml").mkdir()
    else:
        (folder / "package.xml").write_text("<name>parts</name>" + " " * 2**21 if kind == "large" else "<package/>")
    package(tmp_path / "ros" / "parts")
    assert found(template, tmp_path) == "ros/parts"


@pytest.mark.slow
@pytest.mark.parametrize("folder", [".", "..", "elsewhere", "elsewhere/old", "/"])
def test_a_robot_is_the_same_from_every_working_folder(tmp_path, monkeypatch, folder):
    """Expand from several working folders with two packages of one name: always its own."""
    for place, length in (("arms/arm", "0.5"), ("arms/elsewhere/old/arm", "0.7")):
        package(tmp_path / place, "arm")
        (tmp_path / place / "length.xacro").write_text(
            f'<robot {XACRO}><xacro:property name="length" value="{length}"/></robot>')  # fmt: skip
    template = tmp_path / "arms" / "arm" / "arm.xacro"
    template.write_text(
        f'<robot {XACRO} name="arm"><xacro:include filename="$(find arm)/length.xacro"/><link name="a"/>'
        '<link name="b"/><joint name="j" type="fixed">'
        '<parent link="a"/><child link="b"/><origin xyz="${length} 0 0"/></joint></robot>'
    )
    monkeypatch.chdir(tmp_path / "arms" / folder)
    for value in ("", os.pathsep, "."):
        monkeypatch.setenv("ROS_PACKAGE_PATH", value)
        assert describe(template).joints["j"].xyz[0] == 0.5
    if folder == "elsewhere/old":
        for named, length in ((".", 0.7), ("..", 0.7), (str(tmp_path / "arms" / "arm"), 0.5)):
            assert describe(template, Reading(package_path=(named,))).joints["j"].xyz[0] == length
        with pytest.raises(StiffgenError, match="--package-path is empty"):
            describe(template, Reading(package_path=("",)))


def test_a_folder_that_does_not_exist_is_named(tmp_path, template):
    with pytest.raises(StiffgenError, match=r"--package-path no.*does not exist"):
        describe(template, Reading(package_path=("no",)))
