# SPDX-License-Identifier: MIT
"""Every campaign in its short form with a fixed seed; the table stands in tests/campaigns/__main__.py."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from campaigns.__main__ import CAMPAIGNS
from support.arms.arms import MAKERS, Arm
from support.project import ROOT, Once


def test_every_campaign_is_a_program_and_the_makefile_lists_it() -> None:
    for name, campaign in CAMPAIGNS.items():
        assert (ROOT / campaign.program).exists(), name
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "tests"), *sys.path])}
    command = [sys.executable, "-m", "campaigns"]
    said = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True).stdout
    assert [line.split()[2].removeprefix("NAME=") for line in said.splitlines()] == list(CAMPAIGNS)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if campaign.in_ci else pytest.mark.wide)
        for name, campaign in CAMPAIGNS.items()
        if campaign.short is not None
    ],
)
def test_short_form(name: str, tmp_path: Path, once: Once) -> None:
    """Arms are generated and compiled once for all campaigns and the tests of the controller."""
    campaign = CAMPAIGNS[name]
    short = str(campaign.short)
    arms = {arm: once(f"arms-{arm}", partial(Arm, arm)) for arm in MAKERS if f"{{{arm}}}" in short}
    command = campaign.command(shlex.split(short.format(folder=tmp_path, **arms)))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "tests"), str(ROOT), *sys.path])}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
