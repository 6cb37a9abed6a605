# SPDX-License-Identifier: MIT
"""emit/README.md, "Add a target", followed: plain C for a machine without vectors, from a record and a template."""

from __future__ import annotations

import ctypes
import subprocess

import numpy as np

from stiffgen.emit import contexts, render
from stiffgen.emit.c import print_kernels
from stiffgen.lower.rounding import Ranges
from stiffgen.lower.variant import BATCH, Variant
from stiffgen.symbolic.potentials import SpringOptions
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


def test_plain_c_has_the_golden_values(chain, golden, tmp_path):
    code, batch = (print_kernels(chain, "plain", variant, SpringOptions()) for variant in (PLAIN, BATCH))
    none_stated = {kernel.qualified_name: () for kernel, _ in code.kernels}
    robot = render._pages(chain, "plain", code, batch, None, none_stated, Ranges())
    kernels = [contexts.kernel_page(chain, "plain", PLAIN.scalar, *each, ()).definition for each in code.kernels]
    definitions = [*contexts.shared_functions(code), *kernels]
    pages = vars(robot) | {"variant": PLAIN, "code": code, "definitions": definitions}
    (tmp_path / "plain.c").write_text(render._templates().from_string(TEMPLATE).render(pages))
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
