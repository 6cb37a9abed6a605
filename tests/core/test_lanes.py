# SPDX-License-Identifier: MIT
"""Chains whose rows fill lanes partly, exactly or several times over, in builds with every width of lanes."""

from __future__ import annotations

import numpy as np
import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.core.verify.verify import verify
from support.chains import chain_urdf

FLAGS = {
    "native": "-march=native",
    "AVX2": "-mno-avx512f",
    "SSE2": "-mno-avx",
    "no vectors": "-DSTIFFGEN_NO_VECTORS",
}


CHAINS = {"rprmrr": ["AVX2", "no vectors"], "rrprrrrrr": ["native"], "rrrpmrrrrrrr": ["SSE2"]}
"""Widths of the single calls by chain; ``verify`` builds the batches in every width.

Six joints leave places of the second vector empty, nine fill the widest vector and begin another, and eleven
coordinates leave one place of the narrowest. Seven joints in every width: tests/families/rounding/test_rounding.py.
"""


def check_every_oracle(types, widths, name, tmp_path, monkeypatch, count, **options):
    """Verify a chain's folder in builds of several widths, without the controller, which has no lanes of its own."""
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(chain_urdf(types))
    for number, width in enumerate(widths):
        monkeypatch.setenv("CC", f"gcc {FLAGS[width]}")
        # Each folder has its own name: Python loads an extension module once per process.
        folder = stiffgen.generate(urdf, output=tmp_path, name=f"{name}_{types}_{number}", controller=False, **options)
        assert [check for check in verify(folder, count=count) if not check.passed] == [], width


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
def test_a_chain_of_one_joint(tmp_path, monkeypatch):
    kernels = ("hybrid", "spring", "limits", "mass_matrix", "bias_forces", "gravity")
    check_every_oracle("p", ["SSE2"], "quick", tmp_path, monkeypatch, 11, kernels=kernels)


@pytest.mark.wide(instead="test_a_chain_of_one_joint")
@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("types", CHAINS)
def test_every_chain(types, tmp_path, monkeypatch):
    check_every_oracle(types, CHAINS[types], "chain", tmp_path, monkeypatch, 11)


@pytest.mark.usefixtures("unoptimised", "narrowest_width")
@pytest.mark.wide(instead="tests/families/derivatives/test_derivatives.py::test_folder_is_verified")
@pytest.mark.parametrize(
    ("types", "widths", "options"),
    [
        # The rows of five joints have places beyond the last vector, which nothing writes and no sum may read.
        ("rrrrr", ["SSE2"], {}),
        # Nine joints, six of them the base's own, and eight coordinates.
        ("rpm", ["AVX2"], {"floating_base": True, "kernels": ("body", "spring", "mass_matrix", "gravity")}),
        # One joint has a zero dJ/dq: what an oracle's rounding leaves of zero is no fault.
        ("r", ["native"], {"runtime_tool": True}),
    ],
)
def test_derivatives(types, widths, options, tmp_path, monkeypatch):
    """Check all oracles of robots whose rows do not fill the vectors, in one width each."""
    check_every_oracle(types, widths, "derivatives", tmp_path, monkeypatch, 3, derivatives=True, **options)


def test_ten_thousand_at_once_need_no_memory_but_the_result(robot):
    """Strided arguments go through a buffer of constant size."""
    import tracemalloc

    q = np.zeros((10_000, 14))[:, ::2]
    out = np.empty((10_000, 6, 7))
    robot.hybrid.jacobian(q[:2], out=out[:2])
    tracemalloc.start()
    robot.hybrid.jacobian(q, out=out)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200_000
    assert robot.BASE == "link_0"


@pytest.mark.usefixtures("unoptimised")
def test_a_robot_of_slides_alone_has_no_sine(tmp_path):
    urdf = tmp_path / "slides.urdf"
    urdf.write_text(chain_urdf("pp"))
    folder = stiffgen.generate(urdf, output=tmp_path, name="slides", controller=False, batches=False)
    assert "sine_cosine" not in (folder / "slides.c").read_text()
    assert np.isfinite(open_robot(folder).module.hybrid.jacobian([0.1, 0.2])).all()
