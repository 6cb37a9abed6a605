# SPDX-License-Identifier: MIT
"""What the benchmarks count and claim: instructions, the bound of their units, sentences that pages repeat."""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks import claims, cuda_grid
from benchmarks.compiled import motion
from benchmarks.instructions import Instruction, compiled_steps, counted, least_cycles
from stiffgen import StiffnessModel, load_chain
from support.project import ROOT, URDF, assert_close, require_program

FMA = Instruction("vfmadd231pd", "ymm0,ymm1,ymm2")


@pytest.mark.parametrize(
    ("mnemonic", "operands", "accesses", "units"),
    [
        ("vfmadd231pd", "ymm0,ymm1,ymm2", (0, 0), (0, 1)),
        ("vmulpd", "ymm0,ymm1,YMMWORD PTR [rdi]", (1, 0), (0, 1)),
        ("vaddsd", "xmm0,xmm1,xmm2", (0, 0), (2, 3)),
        ("vunpcklpd", "zmm0,zmm1,zmm2", (0, 0), (1, 2)),
        ("vmovupd", "YMMWORD PTR [rdi+0x20],ymm1", (0, 1), None),
        ("vmovapd", "ymm3,ymm1", (0, 0), None),
        ("mulsd", "xmm0,QWORD PTR [rax]", (1, 0), (0, 1)),
        ("add", "QWORD PTR [rsp+0x8],0x1", (1, 1), None),
        ("cmp", "QWORD PTR [rsp+0x8],0x1", (1, 0), None),
        ("lea", "rax,[rdi+rdi*2]", (0, 0), None),
        ("push", "rbp", (0, 1), None),
    ],
)
def test_what_an_instruction_needs(
    mnemonic: str, operands: str, accesses: tuple[int, int], units: tuple[int, ...] | None
) -> None:
    """Parse instructions of x86: memory accesses (reads, writes) and execution units."""
    found = Instruction(mnemonic, operands)
    assert found.accesses == accesses
    assert (found.unit[0] if found.unit else None) == units


def test_the_bound_is_that_of_the_busiest_units() -> None:
    """Compute the bound by hand: two multiplications per cycle, one of 512 bits, six operations, one store."""
    assert least_cycles(Counter({FMA: 100})) == (50, "multiplications")
    assert least_cycles(Counter({Instruction("vmulpd", "zmm0,zmm1,zmm2"): 100})) == (100, "multiplications")
    assert least_cycles(Counter({Instruction("add", "rax,rbx"): 120})) == (20, "dispatch")
    assert least_cycles(Counter({Instruction("vmovupd", "YMMWORD PTR [rdi],ymm1"): 30})) == (30, "stores")
    mixed = Counter({FMA: 60, Instruction("vunpckhpd", "ymm0,ymm1,ymm2"): 60})  # three units for both kinds
    assert least_cycles(mixed) == (40, "vector units 0, 1, 2")


def test_instructions_are_counted_one_by_one(tmp_path: Path) -> None:
    """Count a loop of known length: 3 + 7 turns of 3 instructions, and the return."""
    require_program("gcc", "gcc")
    source = tmp_path / "known.c"
    source.write_text(
        'void run(const double *q, const double *f, const double *K, double *r);\n__asm__(".globl run\\nrun:\\n'
        'xor %eax, %eax\\nnop\\nmov $7, %ecx\\n1: add $2, %eax\\ndec %ecx\\njne 1b\\nret\\n");\n'
    )
    library = tmp_path / "known.so"
    subprocess.run(["gcc", "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    (tmp_path / "inputs").write_bytes(np.zeros(5 * 13 + 36).tobytes())
    found = counted(compiled_steps(tmp_path), tmp_path / "inputs", library, "run", 5)
    assert sum(found.values()) == 5 * (3 + 7 * 3 + 1)
    assert sum(times for each, times in found.items() if each.mnemonic == "dec") == 5 * 7


def test_a_path_is_slow_and_within_the_limits() -> None:
    q = motion(load_chain(URDF), 2000)
    assert np.abs(np.diff(q, axis=0)).max() < 3e-3
    assert np.abs(q).max() < np.radians(170)
    assert np.ptp(q, axis=0).min() > 0.5


def test_the_peers_contraction_is_the_joint_stiffness() -> None:
    """cuda_grid.py makes GRiD's derivative and Hessian of the pose into the matrix that ours is compared with."""
    model = StiffnessModel(load_chain(URDF, tip=cuda_grid.TIP))
    (q,), (force,) = cuda_grid.drawn(1)
    derivative = np.array(model.hybrid.jacobian_transpose_derivative(q)).reshape(7, 7, 6)
    J, K = np.array(model.hybrid.jacobian(q)), np.zeros((6, 6))
    K[:3, :3] = cuda_grid.K
    found = cuda_grid.contracted(np, J[None], derivative.transpose(2, 1, 0)[None], force[None], cuda_grid.K)
    assert_close(found[0], np.array(model.hybrid.joint_stiffness(q, [*force, 0, 0, 0], K)))


def test_pages_say_what_was_measured() -> None:
    """README's figures of speed are sentences of the last run, and so are the paper's."""
    said = claims.stated((ROOT / "benchmarks" / "RESULTS.md").read_text())
    assert len(said) == 5
    for page in claims.PAGES:
        text = " ".join((ROOT / page).read_text().split())
        assert any(sentence in text for sentence in said), page
        for sentence in said:
            text = text.replace(sentence, "")
        assert not re.findall(r"\d (?:ns|us|cycles(?! per second)|times (?:as long|slower|faster))\b", text), page


def test_new_sentences_replace_the_old(tmp_path: Path) -> None:
    """Replace measured sentences of the pages: line breaks and bullets stay as they should."""
    old, new = ["A takes 10 ns.", "B takes 2 us."], ["A takes 20 ns, and that is " + "long " * 30 + "enough.", "B."]
    (tmp_path / "docs" / "paper").mkdir(parents=True)
    (tmp_path / "README.md").write_text("x\n* A takes\n  10 ns.\ny\n")
    (tmp_path / "docs" / "paper" / "paper.md").write_text("x\nB takes 2\nus.\nA takes 10 ns. And more\n")
    assert claims.renew(old, new, tmp_path) == list(claims.PAGES)
    first, second = ((tmp_path / page).read_text() for page in claims.PAGES)
    assert " ".join(first.split()) == f"x * {new[0]} y"
    assert max(map(len, first.splitlines())) <= claims.WIDTH
    assert re.search(r"^  \w", first, re.MULTILINE)  # the second line of the bullet
    assert second == "x\nB.\nA takes 10 ns. And more\n"  # only a sentence with lines of its own
