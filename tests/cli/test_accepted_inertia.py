# SPDX-License-Identifier: MIT
"""Impossible inertias that the user accepts: used as they are against Pinocchio, else the nearest possible tensor."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from stiffgen import StiffnessModel, load_chain
from stiffgen.cli import main
from stiffgen.core.errors import DescriptionError, InertiaWarning, StiffgenError
from stiffgen.core.opened import open_robot
from stiffgen.core.robot.impossible import mass_matrix, nearest_possible

KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
SOUND = (0.02, 0.001, 0.0, 0.03, 0.002, 0.025)
TRIANGLE = (7.8e-05, 5.17e-06, 2.43e-05, 8.70e-05, 1.249e-05, 2.605e-05)
LINE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.01)
NEGATIVE = (0.02, 0.0, 0.0, -0.003, 0.0, 0.018)
LARGE = (0.02, 0.0, 0.0, -3.0, 0.0, 0.018)


def full(tensor: tuple[float, ...]) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = tensor
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def arm(tensors: tuple[tuple[float, ...], ...], mass: float = 0.8) -> str:
    """Return an arm with a link per tensor, each joint about another axis."""
    text = '<robot name="arm"><link name="l0"/>'
    for k, tensor in enumerate(tensors):
        inertia = " ".join(f'{key}="{value}"' for key, value in zip(KEYS, tensor, strict=True))
        text += (
            f'<link name="l{k + 1}"><inertial><origin xyz="0.1 0.02 0.05" rpy="0.3 0.2 0.1"/><mass value="{mass}"/>'
            f'<inertia {inertia}/></inertial></link><joint name="j{k}" type="revolute"><parent link="l{k}"/>'
            f'<child link="l{k + 1}"/><origin xyz="0.2 0 0.1"/><axis xyz="{("0 0 1", "0 1 0", "1 0 0")[k % 3]}"/>'
            '<limit lower="-2" upper="2" velocity="1" effort="9"/></joint>'
        )
    return text + "</robot>"


def written(folder: Path, text: str) -> Path:
    (folder / "arm.urdf").write_text(text)
    return folder / "arm.urdf"


def pinocchio_masses(file: Path, q: np.ndarray) -> np.ndarray:
    model = pin.buildModelFromUrdf(str(file))
    matrix = pin.crba(model, model.createData(), q)
    return np.asarray(np.triu(matrix) + np.triu(matrix, 1).T)


WORDS = {
    "triangle": (TRIANGLE, r"largest principal moment, 9.73e-05 kg m\^2, is above the sum of .* by 3.6 % of it"),
    "line": (LINE, r"largest principal moment, 0.01 kg m\^2, .* by 100.0 %"),
    "negative": (NEGATIVE, r"least principal moment is negative, -0.003 kg m\^2"),
}  # fmt: skip


@pytest.mark.parametrize("name", WORDS)
def test_the_refusal_has_the_number_and_the_remedy(name: str, tmp_path: Path) -> None:
    tensor, words = WORDS[name]
    with pytest.raises(
        DescriptionError, match=rf"link 'l2': .*\(its {words}.*accept_inertia=\[.l2.\]\), or .*masses=False"
    ):
        load_chain(written(tmp_path, arm((SOUND, tensor, SOUND))))


@pytest.mark.slow
@pytest.mark.parametrize("accepted", ["l2", "all"])
@pytest.mark.parametrize("tensor", [TRIANGLE, LINE, NEGATIVE])
def test_an_accepted_inertia_is_used_as_it_is(tensor: tuple[float, ...], accepted: str, tmp_path: Path) -> None:
    """Accept an inertia with which the mass matrix stays positive definite: it is used as it is."""
    file = written(tmp_path, arm((SOUND, tensor, SOUND)))
    with pytest.warns(InertiaWarning, match=r"link 'l2': its .* kg m\^2.*; used as it is"):
        chain = load_chain(file, accept_inertia=[accepted])
    q = np.array([0.3, -0.7, 1.1])
    expected = pinocchio_masses(file, q)
    assert np.array(StiffnessModel(chain).mass_matrix(q)) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert mass_matrix(chain, np.stack([0 * q, q]))[1] == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert [(each.link, each.is_nearest) for each in chain.accepted] == [("l2", False)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::stiffgen.core.errors.InertiaWarning")
@pytest.mark.parametrize("tensor", [LARGE, (-0.5, 0.2, 0.0, 0.1, 0.0, 0.1), (0.0, 0.9, 0.9, 0.0, 0.9, 0.0)])
def test_an_indefinite_mass_matrix_gets_the_nearest_tensor(tensor: tuple[float, ...], tmp_path: Path) -> None:
    """Accept an inertia with an indefinite mass matrix: M becomes Pinocchio's of the nearest possible tensor."""
    file = written(tmp_path, arm((SOUND, SOUND, tensor)))
    chain = load_chain(file, accept_inertia=["all"])
    assert [(each.link, each.is_nearest) for each in chain.accepted] == [("l3", True)]
    random = np.random.default_rng(3)
    states = random.uniform(-2, 2, (50, 3))
    assert min(np.linalg.eigvalsh(pinocchio_masses(file, q))[0] for q in states) < 0  # as the file has it
    possible = written(tmp_path, arm((SOUND, SOUND, nearest_possible(tensor))))
    ours = StiffnessModel(chain)
    for q in states:
        expected = pinocchio_masses(possible, q)
        assert np.array(ours.mass_matrix(q)) == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert np.linalg.eigvalsh(expected)[0] > 0


RANGES = {"from -178 deg": "-3.1 3.1", "from zero": "0.0 3.1", "without limits": ""}


@pytest.mark.filterwarnings("ignore::stiffgen.core.errors.InertiaWarning")
@pytest.mark.parametrize("name", RANGES)
def test_the_mass_matrix_is_checked_over_the_joint_range(name: str, tmp_path: Path) -> None:
    """Let a negative moment count only a quarter turn from zero and from both ends: the check finds it."""
    text = arm(((0.02, 0.0, 0.0, 0.02, 0.0, 0.02), (0.03, 0.0, 0.0, -0.05, 0.0, 0.03)))
    text = text.replace('<origin xyz="0.1 0.02 0.05" rpy="0.3 0.2 0.1"/>', "").replace("0.2 0 0.1", "0 0 0.1")
    text = text.replace('axis xyz="0 1 0"', 'axis xyz="1 0 0"')
    file = written(tmp_path, text)
    least = [np.linalg.eigvalsh(pinocchio_masses(file, np.array([0.0, q])))[0] for q in (0.0, -3.1, 3.1, np.pi / 2)]
    if ends := RANGES[name].split():
        file = written(tmp_path, text.replace('lower="-2" upper="2"', f'lower="{ends[0]}" upper="{ends[1]}"'))
    else:
        file = written(tmp_path, text.replace("revolute", "continuous"))
    assert min(least[:3]) > 0.02 and least[3] < -0.02  # smallest eigenvalue of the mass matrix [kg m^2]
    chain = load_chain(file, accept_inertia=["all"])
    assert [(each.link, each.is_nearest) for each in chain.accepted] == [("l2", True)]


@pytest.mark.parametrize("tensor", [TRIANGLE, LINE, NEGATIVE, LARGE])
def test_no_possible_tensor_is_nearer(tensor: tuple[float, ...]) -> None:
    """Compare the nearest possible tensor with others: none is nearer.

    Possible: second moments positive semidefinite.
    """

    def second(matrix: np.ndarray) -> np.ndarray:
        return np.asarray(np.eye(3) * np.trace(matrix) / 2 - matrix)

    wanted, found = second(full(tensor)), second(full(nearest_possible(tensor)))
    size = np.abs(wanted).max()
    assert np.linalg.eigvalsh(found)[0] >= -1e-15 * size
    distance = np.linalg.norm(found - wanted)
    random = np.random.default_rng(5)
    for scale in (1e-3, 1e-2, 1e-1, 1.0):
        for _ in range(200):
            root = np.linalg.cholesky(found + 1e-9 * size * np.eye(3)) + scale * np.sqrt(size) * random.normal(
                size=(3, 3)
            )
            assert np.linalg.norm(root @ root.T - wanted) >= distance - 1e-6 * size
    assert nearest_possible(SOUND) == pytest.approx(SOUND, rel=1e-14, abs=1e-16)


def test_links_beside_the_chain_and_unknown_ones(tmp_path: Path) -> None:
    file = written(tmp_path, arm((SOUND, TRIANGLE, SOUND)))
    with pytest.raises(StiffgenError, match=r"accept_inertia=\[.elbow.\]: is no link; valid names: l0, l1"):
        load_chain(file, accept_inertia=["elbow"])
    assert load_chain(file, accept_inertia=["all"], masses=False).accepted == ()
    with pytest.raises(DescriptionError, match="link 'l2'"):
        load_chain(file, accept_inertia=["l3"])


RECORDED = {
    "line": (LINE, "its largest principal moment, 0.01 kg m^2", False),
    "triangle": (TRIANGLE, "its largest principal moment, 9.73e-05 kg m^2", False),
    "the nearest": (LARGE, "its least principal moment is negative, -3 kg m^2", True),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDED)
def test_generate_records_it_and_verify_reads_it_again(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Accept an impossible inertia: warning, pages and manifest say so, and reading the folder gives the same chain."""
    tensor, fault, is_nearest = RECORDED[name]
    file = written(tmp_path, arm((SOUND, tensor)))
    command = ["generate", str(file), "--accept-inertia", "l2", "--output", str(tmp_path), "--no-build"]
    assert main([*command, "--kernels", "spring", "--no-controller"]) == 0
    err, use = capsys.readouterr().err, "the nearest possible" if is_nearest else "used as it is"
    assert f"warning: arm.urdf: accepted although no rigid body has it: link 'l2': {fault}" in err and use in err
    folder = tmp_path / "arm"
    for page in ("arm.h", "README.md"):
        text = " ".join((folder / page).read_text().replace("\n *", "").split())
        assert f"Link l2 has an inertia that no rigid body has ({fault}" in text and use in text
    (recorded,) = json.loads((folder / "manifest.json").read_text())["chain"]["accepted"]
    assert (recorded["link"], recorded["is_nearest"]) == ("l2", is_nearest) and fault in recorded["fault"]
    assert open_robot(folder).chain == load_with_warning(file)


def load_with_warning(file: Path):  # type: ignore[no-untyped-def]
    with pytest.warns(InertiaWarning):
        return load_chain(file, accept_inertia=["l2"])


@pytest.mark.slow
def test_new_says_the_remedy_and_takes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse a project of a robot with impossible inertias, name the option, and take it."""
    file = written(tmp_path, arm((SOUND, LINE, TRIANGLE)))
    command = ["new", str(file), "--no-build", "--output", str(tmp_path / "project")]
    assert main(command) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert (
        "correct <inertia>, accept it (--accept-inertia l2), or leave all masses out (--no-masses) (and 1 more)" in said
    )
    assert main([*command, "--accept-inertia", "all"]) == 0
    assert "--accept-inertia l2 --accept-inertia l3" in (tmp_path / "project" / "README.md").read_text()
