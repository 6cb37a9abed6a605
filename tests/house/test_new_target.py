# SPDX-License-Identifier: MIT
"""emit/README.md, "Add a backend", followed: plain C for a machine without vectors, from a record and a template."""

from __future__ import annotations

import ctypes
import subprocess

import numpy as np
import pytest

from stiffgen.core.emit.backend import Backend, Request
from stiffgen.core.emit.c.backend import BACKEND as C
from stiffgen.core.emit.pages import shared_functions
from stiffgen.core.emit.render import print_files
from stiffgen.core.lower.variant import Variant
from support.project import assert_close, require_compiler

PLAIN = Variant()
TEMPLATE = """\
{% from "macros.j2" import finite_or_nan, function, helpers, tables %}
{% from "choices.c.j2" import choices with context %}
#include <math.h>
#include <stddef.h>
#include <string.h>

{{ tables(variant, robot, code.scopes, code.calls) }}
{{ finite_or_nan(variant) }}{{ choices(variant, code.calls) }}{{ helpers(variant, code.calls) }}

static void sine_cosine(const double *x, double *sine, double *cosine, int count)
{
    for (int k = 0; k < count; ++k) {
        sine[k] = sin(x[k]);
        cosine[k] = cos(x[k]);
    }
}
{% for definition in definitions %}{{ function(definition) }}{% endfor %}
"""


@pytest.mark.slow
def test_a_backend_s_own_template_comes_first(chain, tmp_path):
    """Give a new backend templates of known names: its own are used. Before: those of emit/c."""
    (tmp_path / "templates").mkdir()
    for file, text in (("macros.j2", "{% macro line() %}own{% endmacro %}"), ("helper.j2", "helper of {{ name }}")):
        (tmp_path / "templates" / file).write_text(text)
    own = '{% from "macros.j2" import line %}{{ line() }} header, {% include "helper.j2" %}'
    (tmp_path / "templates" / "header.h.j2").write_text(own)
    mine = Backend(tmp_path, lambda request: {"mine.h": "header.h.j2"})
    texts = print_files(Request(chain, "arm"), [C, mine])
    assert texts["mine.h"] == "own header, helper of arm"
    assert texts["arm.h"] == print_files(Request(chain, "arm"), [C])["arm.h"]


def plain_files(request: Request) -> dict[str, str]:
    return {f"{request.name}.c": "plain.c.j2"}


def plain_variables(request: Request) -> dict[str, object]:
    code = request.print(PLAIN)
    functions = [*shared_functions(code), *(page.definition for page in request.pages(code))]
    return {"variant": PLAIN, "code": code, "definitions": functions}


@pytest.mark.slow
def test_plain_c_has_the_golden_values(chain, golden, tmp_path):
    """Print plain C by a new backend of a few lines: golden values."""
    (tmp_path / "templates").mkdir()
    (tmp_path / "templates" / "plain.c.j2").write_text(TEMPLATE)
    texts = print_files(Request(chain, "plain"), [Backend(tmp_path, plain_files, plain_variables)])
    (tmp_path / "plain.c").write_text(texts["plain.c"])
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    command = [require_compiler("gcc"), *flags, "plain.c", "-o", "plain.so", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "plain.so"))
    for sample in golden:
        for rep in ("body", "spatial", "hybrid"):
            found = np.full((7, 7), np.nan)
            given = [np.ascontiguousarray(x) for x in (sample.q, sample.wrench, sample.task_stiffness)]
            addresses = [ctypes.c_void_p(x.ctypes.data) for x in (*given, found)]
            getattr(library, f"plain_{rep}_joint_stiffness")(*addresses)
            assert_close(found, sample.by[rep]["joint_stiffness"])
