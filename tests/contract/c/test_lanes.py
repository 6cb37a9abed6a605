# SPDX-License-Identifier: MIT
"""Chains whose rows fill lanes partly, exactly or several times over, in builds with every width of lanes."""

from __future__ import annotations

import numpy as np
import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.verify.verify import verify
from support.chains import chain_urdf

FLAGS = {
    "native": "-O3",
    "AVX2": "-O2 -mno-avx512f",
    "SSE2": "-O2 -mno-avx",
    "no vectors": "-O1 -DSTIFFGEN_NO_VECTORS",
}


CHAINS = ("rprmrr", "p", "rrprrrrrr", "rrrpmrrrrrrrrrrrr")


@pytest.mark.usefixtures("unoptimised")
def test_a_chain_of_one_joint(tmp_path, monkeypatch):
    check_every_oracle("p", "SSE2", "quick", tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("types", CHAINS)
@pytest.mark.parametrize("flags", FLAGS)
def test_every_chain(types, flags, tmp_path, monkeypatch):
    check_every_oracle(types, flags, "chain", tmp_path, monkeypatch)


def check_every_oracle(types, flags, name, tmp_path, monkeypatch):
    monkeypatch.setenv("CC", f"gcc {FLAGS[flags]}")
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(chain_urdf(types))
    # Names of their own: an extension module is loaded once a process.
    folder = stiffgen.generate(urdf, output=tmp_path, name=f"{name}_{types}_{list(FLAGS).index(flags)}")
    assert [check for check in verify(folder, count=11) if not check.passed] == []


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.slow
@pytest.mark.parametrize("flags", ["no vectors", "SSE2"])
def test_derivatives_where_lanes_do_not_fill_the_rows(flags, tmp_path, monkeypatch):
    """Five joints: the rows have places beyond the last block, which nothing writes and no sum may read."""
    monkeypatch.setenv("CC", f"gcc {FLAGS[flags]}")
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(chain_urdf("rrrrr"))
    name = f"narrow_{list(FLAGS).index(flags)}"
    folder = stiffgen.generate(urdf, output=tmp_path, name=name, springs=stiffgen.SpringOptions(derivatives=True))
    assert [check for check in verify(folder, count=3) if not check.passed] == []


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "types"),
    [("no vectors", "rm"), *((flags, "rpm") for flags in FLAGS)],
)
def test_derivatives_on_a_floating_base(flags, types, tmp_path, monkeypatch):
    """Eight or nine joints, six of them the base's own, seven or eight coordinates."""
    monkeypatch.setenv("CC", f"gcc {FLAGS[flags]}")
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(chain_urdf(types))
    name, options = f"floating_{list(FLAGS).index(flags)}_{types}", stiffgen.SpringOptions(derivatives=True)
    folder = stiffgen.generate(urdf, output=tmp_path, name=name, springs=options, floating_base=True)
    assert [check for check in verify(folder, count=3) if not check.passed] == []


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.slow
def test_one_joint_whose_tool_is_mounted_at_run_time(tmp_path):
    """Its dJ/dq is zero: what an oracle's rounding leaves of zero is no fault."""
    urdf = tmp_path / "chain.urdf"
    urdf.write_text(chain_urdf("r"))
    options = stiffgen.SpringOptions(derivatives=True)
    folder = stiffgen.generate(urdf, output=tmp_path, name="tool_of_one", springs=options, runtime_tool=True)
    assert [check for check in verify(folder, count=3) if not check.passed] == []


def test_batches_of_every_length(robot, chain):
    """Shared and own wrenches, backwards and spread arguments, and nothing written beyond the end."""
    from stiffgen.verify.verify import Samples

    samples = Samples.draw(chain, 21, seed=3)
    kernel = robot.hybrid.joint_stiffness
    everything = kernel(samples.q, samples.wrench, samples.task_stiffness)
    for count in range(22):
        out = np.full((count + 1, 7, 7), -1.0)
        kernel(samples.q[:count], samples.wrench[:count], samples.task_stiffness[:count], out=out[:count])
        assert (out[count] == -1).all()
        if count != 1:  # a single call
            assert np.array_equal(out[:count], everything[:count])
    shared = kernel(samples.q, samples.wrench[3], samples.task_stiffness)
    assert np.array_equal(shared[3], everything[3])
    assert np.array_equal(kernel(samples.q[::-2], samples.wrench[::-2], samples.task_stiffness[::-2]), everything[::-2])


def test_a_nan_stays_in_its_configuration(robot, chain):
    from stiffgen.verify.verify import Samples

    samples = Samples.draw(chain, 19, seed=5)
    expected = robot.hybrid.joint_stiffness(samples.q, samples.wrench, samples.task_stiffness)
    for array, at in ((samples.q, (4, 2)), (samples.wrench, (4, 1)), (samples.task_stiffness, (4, 0, 3))):
        for value in (np.nan, np.inf):
            kept, array[at] = array[at], value
            with np.errstate(invalid="ignore"):
                found = robot.hybrid.joint_stiffness(samples.q, samples.wrench, samples.task_stiffness)
            array[at] = kept
            assert np.isnan(found[4]).all()
            others = np.arange(19) != 4
            assert np.array_equal(found[others], expected[others])


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
    folder = stiffgen.generate(urdf, output=tmp_path, name="slides")
    assert "sine_cosine" not in (folder / "slides.c").read_text()
    assert np.isfinite(open_robot(folder).module.hybrid.jacobian([0.1, 0.2])).all()
