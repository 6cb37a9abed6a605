"""Vector-Jacobian products in C, batches and CUDA."""

from __future__ import annotations

import json

import numpy as np
import pytest

import stiffgen
from stiffgen.check.result import BOUND, as_results, relative_error
from stiffgen.check.verify import argument_samples, verify
from stiffgen.emit.render import render
from stiffgen.emit.target import CUDA
from stiffgen.opened import open_robot
from stiffgen.symbolic.model import casadi_function, folded
from stiffgen.symbolic.potentials import SpringOptions
from support.chains import chain_urdf
from support.cuda_host import HostCuda

OPTIONS = SpringOptions(derivatives=True)


@pytest.fixture
def urdf(tmp_path):
    file = tmp_path / "chain.urdf"
    file.write_text(chain_urdf("rpm"))
    return file


def expected(chain, kernel, pool, count):
    """Results of the CasADi function, one array a result, for the first states of the pool."""
    function = casadi_function(chain, kernel)
    folds = [folded(a.array(chain).shape) for a in kernel.arguments]
    rows = []
    for c in range(count):
        one = [pool[a][c].reshape(f) for a, f in zip(kernel.arguments, folds, strict=True)]
        rows.append([np.asarray(each).ravel() for each in as_results(function(*one))])
    return [np.stack(each) for each in zip(*rows, strict=True)]


def test_default_folder_knows_nothing_of_it(urdf):
    texts = render(stiffgen.load_chain(urdf), "arm")
    assert not any("vjp" in text for text in texts.values())
    assert "derivatives" not in json.loads(texts["manifest.json"])


@pytest.mark.slow
def test_folder_is_verified(urdf, tmp_path):
    """Against differences and CasADi, with NaN, stacks of every length and the bounds of memory; reopened as it was."""
    folder = stiffgen.generate(urdf, output=tmp_path, name="arm", springs=OPTIONS)
    robot = open_robot(folder)
    assert robot.springs.derivatives
    assert sum(kernel.name.endswith("_vjp") for kernel in robot.table) * 2 == len(robot.table)
    assert [check for check in verify(folder, count=20) if not check.passed] == []


@pytest.mark.slow
def test_cuda_on_the_host(urdf, tmp_path):
    """Cotangents lie with each configuration; gradients come back whole."""
    chain = stiffgen.load_chain(urdf)
    texts = render(chain, "arm", cuda=CUDA, options=OPTIONS)
    for name in ("arm.cu", "arm_cuda.h"):
        (tmp_path / name).write_text(texts[name])
    host = HostCuda(tmp_path / "arm.cu", "arm", chain, tmp_path, options=OPTIONS)
    count = 5
    pool = argument_samples(chain, count, 3, OPTIONS)
    for name, kernel in host.kernels.items():
        if not name.endswith("_vjp"):
            continue
        own = {a: len(a.shape) == 1 or a.own or a.varying for a in kernel.arguments}
        shared = {a: np.broadcast_to(pool[a][0], pool[a].shape) for a in kernel.arguments if not own[a]}
        wanted = expected(chain, kernel, {**pool, **shared}, count)
        given = [pool[a][:count] if own[a] else pool[a][0] for a in kernel.arguments]
        for found, each in zip(as_results(host(name, *given, spare=2)), wanted, strict=True):
            assert relative_error(found.reshape(count, -1), each) <= BOUND, name
