# SPDX-License-Identifier: MIT
"""gcc has no warning for the C of random robots, at any level; compiler_warnings.py compiles more."""

from __future__ import annotations

import re

import pytest

import stiffgen
from stiffgen.core.emit.render import render
from stiffgen.core.options import GenerationOptions
from support.chains import chain_urdf
from support.project import require_compiler
from support.warnings import LEVELS, complaints, sources_of_random_robot, sources_of_varied_robot


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "levels"),
    [(5, ("-O1", "-O3")), *(pytest.param(seed, LEVELS, marks=pytest.mark.wide) for seed in (1, 5))],
)
def test_random_robots_compile_without_a_warning(seed, levels, tmp_path):
    """The controller, whose text differs in sizes alone, of the first robot; the campaign has another's."""
    gcc = require_compiler("gcc")
    sources = [each for each in sources_of_random_robot(seed, 3, tmp_path) if seed == 1 or "impedance" not in each.name]
    assert {level: complaints(gcc, [level], sources) for level in levels} == dict.fromkeys(levels, "")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [19, pytest.param(37, marks=pytest.mark.wide)])
def test_derivatives_of_random_robots_compile_without_a_warning(seed, tmp_path):
    """Of one joint and of five: what one derivative hands to another may be known to be zero."""
    kind, sources = sources_of_varied_robot(seed, 5, tmp_path)
    assert kind == "derivatives"
    assert complaints(require_compiler("gcc"), ["-O0"], sources[:1]) == ""


def test_a_value_that_was_used_up_gets_no_name(tmp_path):
    """In this robot's mass matrix a sum holds a product that a later section would have named for nobody."""
    kind, sources = sources_of_varied_robot(3000, 5, tmp_path)
    assert kind == "plain"
    assert complaints(require_compiler("gcc"), ["-O0"], sources[:1]) == ""


@pytest.mark.slow
def test_derivatives_of_a_floating_base_without_masses_compile_without_a_warning(tmp_path):
    """Bias forces and gravity are zero: gradients with respect to the base's pose must not be declared."""
    urdf = tmp_path / "light.urdf"
    text, count = re.subn("<inertial>.*?</inertial>", "", chain_urdf("r"), flags=re.DOTALL)
    assert count > 0
    urdf.write_text(text)
    chain = stiffgen.load_chain(urdf, floating_base=True)
    options = GenerationOptions(derivatives=True, controller=False, python=False)
    texts = render(chain, "light", options)
    for file, text in texts.items():
        if file.endswith((".c", ".h")):
            (tmp_path / file).write_text(text)
    sources = [tmp_path / "light.c", tmp_path / "light_batch.c"]
    assert complaints(require_compiler("gcc"), ["-O0"], sources) == ""


def test_a_warning_is_seen(tmp_path):
    source = tmp_path / "unused.c"
    source.write_text("int f(double x);\nint f(double x)\n{\n    return x;\n}\n")
    assert "-Werror" in complaints(require_compiler("gcc"), ["-O0"], [source])
