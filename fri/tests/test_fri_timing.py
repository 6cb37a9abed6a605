# SPDX-License-Identifier: MIT
"""The client's histogram of durations: quantiles of callbacks and answers in its summary."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from support.project import ROOT, Once

SOURCE = """
#include "timing.h"
#include <cstdio>
#include <initializer_list>
int main()
{
    static Durations durations;
    for (double seconds; std::scanf("%lf", &seconds) == 1;) { durations.add(seconds); }
    for (double share : {0.01, 0.25, 0.5, 0.75, 0.9999, 1.0}) { std::printf("%.17g ", durations.quantile(share)); }
    std::printf("%.17g\\n", durations.most());
}
"""
SHARES = (0.01, 0.25, 0.5, 0.75, 0.9999, 1.0)


@pytest.fixture(scope="module")
def program(once: Once) -> Path:
    """Program that reads durations [s], and prints their quantiles and the largest."""

    def make(folder: Path) -> None:
        source = folder / "durations.cpp"
        source.write_text(SOURCE)
        command = ["g++", "-std=c++11", "-O1", "-I", ROOT / "fri" / "client", source, "-o", folder / "durations"]
        subprocess.run([str(part) for part in command], check=True)

    return once("fri-durations", make) / "durations"


RANDOM = np.random.default_rng(1)
DURATIONS = {
    "an answer in three is late": np.array([5e-3, 5e-3, 0.264654]),
    "all beyond 2 ms": RANDOM.uniform(2e-3, 0.3, 999),
    "half beyond 2 ms": np.concatenate([RANDOM.uniform(1e-5, 1e-3, 500), RANDOM.uniform(2.1e-3, 5.0, 501)]),
    "microseconds to an hour": 10.0 ** RANDOM.uniform(-6.0, 3.5, 2000),
    "about 2 ms": np.linspace(1.99e-3, 2.01e-3, 401),
    "a clock that stepped back": np.array([-1.0, 0.0, 1e-5, 2e-4, 3.0]),
    "one": np.array([0.1]),
}


@pytest.mark.parametrize("name", DURATIONS)
def test_quantiles_are_those_of_the_durations(program: Path, name: str) -> None:
    """Up to 0.1 us or 1 %. Before, each quantile beyond 2 ms was the largest duration: 264 654 us for 5000."""
    durations = DURATIONS[name]
    text = "\n".join(map(repr, durations.tolist()))
    told = subprocess.run([program], input=text, capture_output=True, text=True, check=True).stdout.split()
    *quantiles, most = map(float, told)
    exact = np.quantile(np.maximum(durations, 0.0), SHARES, method="inverted_cdf")
    assert most == durations.max()
    assert (np.array(quantiles) >= exact * (1.0 - 1e-9)).all()
    assert (np.array(quantiles) <= np.maximum(exact * 1.01, exact + 1e-7) * (1.0 + 1e-9)).all()
    assert quantiles[-1] == most
