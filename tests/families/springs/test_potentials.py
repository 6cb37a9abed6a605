# SPDX-License-Identifier: MIT
"""A user's potentials of every kind with every option: the C compiles without a warning, and its values are right."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from stiffgen.cli import main
from stiffgen.core.verify.verify import verify
from support.c_program import STRICT

POTENTIALS = """
import casadi as ca

def polynomial(p, R, parameters):
    return ca.dot(p, p) ** 2 / 4 + (1 - R[0, 0]) * p[2]

def sines(p, R, parameters):
    return ca.cos(3 * p[0]) + ca.sin(p[1]) * ca.sin(2 * ca.cos(p[2])) + ca.cos(R[0, 1])

def roots(p, R, parameters):
    return ca.sqrt(1 + ca.dot(p, p)) + ca.exp(-ca.dot(p, p)) + ca.atan2(p[0], 2 + p[1])

def larger(p, R, parameters):
    return ca.fmax(0, p[2] - 0.1) ** 9 + ca.fabs(p[0]) ** 9 + ca.fmin(p[1], 0.2) ** 9

def pieces(p, R, parameters):
    return ca.if_else(p[0] < 0, p[0] ** 10, ca.sin(p[0]) ** 9)

def chosen(p, R, parameters):
    away, turned = p - parameters.centre, R @ parameters.axes
    return parameters.stiffness * ca.cos(ca.dot(away, away)) + ca.sin(parameters.rate * turned[0, 0])

chosen.parameters = {"centre": (3,), "stiffness": (), "axes": (3, 2), "rate": ()}

def waves(names, p, R, parameters):
    return sum(ca.cos(k * parameters.__getattr__(name) * p[k % 3]) * R[0, k % 3] for k, name in enumerate(names))

def angle(p, R, parameters):
    return waves(LOCALS, p, R, parameters)

def most(p, R, parameters):
    return waves(MOST, p, R, parameters)

def kinks(p, R, parameters):
    return ca.fmax(0, p[2] - 0.1) ** 3 + ca.fabs(p[0]) ** 3

def every_formula(p, R, parameters):
    return sum(each(p, R, parameters) for each in (sines, roots, larger, pieces, kinks))

LOCALS = ("angle", "sine", "J", "K", "q", "p", "R", "x", "i", "n", "a", "a_bar", "a_step", "a_of_tips")
WORDS = (
    "count", "energy", "torque", "wrench", "lanes", "poison", "int", "double", "lambda", "class", "M_PI", "NAN", "I",
    "y0", "j1", "fmax",
)
MOST = (*WORDS, *(f"more{k}" for k in range(27 - len(WORDS))))
angle.parameters = {name: () for name in LOCALS}
most.parameters = {name: () for name in MOST}
"""
NAMES = ("polynomial", "sines", "roots", "larger", "pieces", "chosen", "angle", "most", "kinks")
"""Parameters have names of locals, of C, C++ and Python, of math.h, and names that the printers make of another one.

``most`` has as many as a potential may have.
"""
FORMULAS = ("every_formula", "chosen")
"""Every formula, in few functions; the other potentials differ in names."""
ROBOT = """<robot name="two"><link name="base"/><link name="a"/><link name="b"/><link name="c"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0.1 0.3"/><axis xyz="0 1 0"/>
</joint><joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.4 0 0" rpy="0 0 1"/>
<axis xyz="0 1 0"/></joint><joint name="j3" type="prismatic"><parent link="a"/><child link="c"/>
<origin xyz="0.4 0 0.1" rpy="0 0.3 1"/><axis xyz="0 1 0"/></joint></robot>
"""
TIPS = ("--tip", "b", "--tip", "c")
OPTIONS = {
    "one tip": ("--tip", "b"),
    "derivatives": ("--tip", "b", "--derivatives"),
    "two tips": TIPS,
    "two tips, derivatives": (*TIPS, "--derivatives"),
    "floating base, tool, CUDA": ("--tip", "b", "--floating-base", "--tool", "runtime", "--cuda", "--derivatives"),
    "floats": (*TIPS, "--scalar", "float"),
}


def generated(work: Path, names: tuple[str, ...], *options: str) -> Path:
    """Generate a folder with the functions of some potentials alone."""
    (work / "robot.urdf").write_text(ROBOT)
    (work / "mine.py").write_text(POTENTIALS)
    potentials = [word for name in names for word in ("--potential", f"{work / 'mine.py'}:{name}")]
    potentials += ["--kernels", ",".join(names), "--no-controller"]
    command = ["generate", str(work / "robot.urdf"), "--no-masses", "--name", "made", "--output", str(work)]
    assert main([*command, *potentials, *options]) == 0
    return work / "made"


SLOW = {
    "two tips, derivatives": pytest.mark.wide,
    "floating base, tool, CUDA": pytest.mark.wide,
    "floats": pytest.mark.slow,
}
"""``derivatives`` and ``two tips`` alone are compiled with their values, below."""
FEWER = {"floats": (*FORMULAS, "angle")}
"""Every formula, and names of locals; those of C are the same with doubles."""


@pytest.mark.parametrize("name", ["one tip", *(pytest.param(name, marks=mark) for name, mark in SLOW.items())])
def test_potentials_compile_with_every_option(name: str, tmp_path: Path) -> None:
    folder = generated(tmp_path, FEWER.get(name, NAMES), "--no-build", *OPTIONS[name])
    for file in folder.glob("made*.c"):
        if file.stem in ("made", "made_batch"):
            subprocess.run(["cc", "-std=c99", *STRICT, "-fsyntax-only", file], check=True)
    subprocess.run(["c++", "-std=c++17", "-fsyntax-only", "-x", "c++", folder / "made.hpp"], check=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "potentials"), [("derivatives", FORMULAS), pytest.param("two tips", NAMES, marks=pytest.mark.wide)]
)
@pytest.mark.usefixtures("unoptimised", "narrowest_width")
def test_potentials_have_the_values_of_their_energies(
    name: str, potentials: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compare potentials with their energies; frameworks: tests/lab/languages/test_languages.py."""
    monkeypatch.setattr("stiffgen.lab.languages.check.check_wrappers", lambda material: [])
    folder = generated(tmp_path, potentials, *OPTIONS[name])
    assert [check for check in verify(folder, count=5, trust_potentials=True) if not check.passed] == []
