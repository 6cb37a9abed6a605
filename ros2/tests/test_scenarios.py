# SPDX-License-Identifier: MIT
"""The controller between a manager and a driver, with stubs of ROS 2 in the forms of three distributions."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from .building import SCENARIOS


def test_every_scenario_is_run(scenarios: Callable[[str], Path]) -> None:
    listed = subprocess.run([scenarios("rolling")], capture_output=True, text=True, check=True).stdout.split()
    assert listed == SCENARIOS
    assert len(SCENARIOS) >= 25


def check(program: Path, name: str) -> None:
    done = subprocess.run([program, name], capture_output=True, text=True, check=False, timeout=300)
    assert (done.stdout, done.returncode) == ("", 0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenario(scenarios: Callable[[str], Path], name: str) -> None:
    """On the interfaces of Rolling, which has the fewest: no get_value, and return values that must be read."""
    check(scenarios("rolling"), name)


@pytest.mark.wide(instead="test_scenario")
@pytest.mark.parametrize("distro", ["humble", "jazzy"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_scenario_on_an_older_distribution(scenarios: Callable[[str], Path], name: str, distro: str) -> None:
    check(scenarios(distro), name)
