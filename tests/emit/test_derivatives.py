"""Vector-Jacobian products in C, batches and CUDA: verified, and not one of their signs can be wrong."""

from __future__ import annotations

import ctypes
import itertools
import json
import re

import numpy as np
import pytest

import stiffgen
from stiffgen.check.result import BOUND, as_results, relative_error
from stiffgen.check.verify import argument_samples, verify
from stiffgen.emit.render import render
from stiffgen.emit.target import CUDA
from stiffgen.opened import open_robot
from stiffgen.symbolic.kernels import chain_kernels
from stiffgen.symbolic.model import casadi_function, folded
from stiffgen.symbolic.potentials import SpringOptions
from support.chains import chain_urdf
from support.cuda_host import HostCuda
from support.project import ROOT
from support.runtime import compile_c

OPTIONS = SpringOptions(derivatives=True)
DUAL = ROOT / "tests" / "data" / "dual_arm.urdf"


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
@pytest.mark.parametrize("case", ["slides and mimics", "two tips, tool at run time"])
def test_folder_is_verified(case, urdf, tmp_path):
    """Against differences and CasADi, with NaN, stacks of every length and the bounds of memory; reopened as it was."""
    options = {}
    if case != "slides and mimics":
        urdf, options = DUAL, {"tip": ["left hand", "right-hand"], "runtime_tool": True}
    folder = stiffgen.generate(urdf, output=tmp_path, name="arm", springs=OPTIONS, **options)
    robot = open_robot(folder)
    assert robot.springs.derivatives
    assert sum(kernel.name.endswith("_vjp") for kernel in robot.table) * 2 == len(robot.table)
    assert [check for check in verify(folder, count=20) if not check.passed] == []


SIGN = re.compile(r" [-+] |(?<== )-|(?<=\()-")
FUNCTION = re.compile(r"(?:static |DEVICE )?void (\w+)\(")


def with_switches(source, marker):
    """The source with ``flip[k]`` at the k-th sign of every body whose name has ``marker``, and their lines."""
    lines, places, inside = [], [], ""

    def switch(match):
        before, after = match.string[: match.start()], match.string[match.end() :]
        index = before.count("[") > before.count("]")
        if index or after.startswith("poison") or before.lstrip().startswith(("for", "/*", "*")):
            return match[0]
        places.append(f"{inside}: {match.string.strip()}")
        return f"{match[0]}flip[{len(places) - 1}] * "

    for line in source.splitlines():
        heading = FUNCTION.match(line)
        if heading:
            inside = heading[1] if marker in heading[1] and not heading[1].endswith("_batch") else ""
        code = inside and not line.lstrip().startswith(("for", "/*", "*", "if"))
        lines.append(SIGN.sub(switch, line) if code else line)
    text = "\n".join(lines)
    first = text.index("#include <string.h>") if "#include <string.h>" in text else text.index("#include <math.h>")
    return text[:first] + f"double flip[{len(places)}];\n" + text[first:], places


@pytest.mark.slow
@pytest.mark.parametrize(
    "marker", ["hybrid_joint_stiffness_vjp", "spring_torque_vjp", "jacobian_transpose_derivative_vjp"]
)
def test_no_sign_can_be_wrong(marker, urdf, tmp_path):
    """Every sign of the bodies of some products, single calls and batches, exchanged one at a time."""
    chain = stiffgen.load_chain(urdf)
    texts = render(chain, "arm", options=OPTIONS)
    texts["arm.c"], places = with_switches(texts["arm.c"], marker)
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    flags = ["-std=c99", "-O0", "-DSTIFFGEN_NO_VECTORS", "-shared", "-fPIC"]
    library = ctypes.CDLL(str(compile_c(tmp_path / "arm.so", *flags, tmp_path / "arm.c", "-lm")))
    count = 3
    pool = argument_samples(chain, count, 1, OPTIONS)
    flip = (ctypes.c_double * len(places)).in_dll(library, "flip")
    flip[:] = [1.0] * len(places)
    table = [kernel for kernel in chain_kernels(chain, OPTIONS) if marker in kernel.qualified_name]
    calls = [
        (getattr(library, f"arm_{kernel.qualified_name}{suffix}"), suffix, kernel, expected(chain, kernel, pool, count))
        for kernel in table
        for suffix in (["", "_batch"] if kernel.batch else [""])
    ]

    def agrees(function, suffix, kernel, wanted):
        given = [np.ascontiguousarray(pool[a][:count].reshape(count, -1)) for a in kernel.arguments]
        outs = [np.empty_like(each) for each in wanted]
        if suffix:
            steps = itertools.chain(*((pointer(a), ctypes.c_ssize_t(a.shape[1])) for a in given))
            function(ctypes.c_size_t(count), *steps, *map(pointer, outs))
        else:
            for c in range(count):
                function(*(pointer(each[c : c + 1]) for each in (*given, *outs)))
        return all(relative_error(out, each) <= BOUND for out, each in zip(outs, wanted, strict=True))

    assert len(places) > 20
    assert all(agrees(*call) for call in calls)
    missed = []
    for k, place in enumerate(places):
        flip[k] = -1.0
        if all(agrees(*call) for call in calls):
            missed.append(place)
        flip[k] = 1.0
    assert missed == []


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


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
