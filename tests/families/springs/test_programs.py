# SPDX-License-Identifier: MIT
"""Programs of all kernels: no step writes an array that nothing reads."""

from __future__ import annotations

import pytest

from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from support.small_robots import LINKAGES, TREES

ROBOTS = TREES | LINKAGES


@pytest.mark.parametrize("name", ROBOTS)
def test_every_array_is_read(name, tmp_path):
    """Check the programs: each array is a result or read later, and shared functions fill all outputs."""
    chain = ROBOTS[name].load(tmp_path)
    kernels = chain_kernels(chain, KernelOptions(kernels=("all", "compliance")))
    assert any(kernel.name.startswith("loaded_hessian") for kernel in kernels)
    for kernel in kernels:
        scope = kernel.scope(chain)
        needed = {result.array(scope).name for result in kernel.results}
        for step in reversed(kernel.program(scope)):
            if not getattr(step, "name", ""):
                unread = {array.name for array in step.writes} - needed
                assert not unread, (kernel.qualified_name, unread)
            needed |= {array.name for array in step.reads}
