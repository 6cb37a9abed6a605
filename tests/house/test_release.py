# SPDX-License-Identifier: MIT
"""What is prepared for a release agrees with what the project does itself."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import tomllib

import pytest
import yaml

import stiffgen
from stiffgen.cli import parser
from support.project import ROOT


def installed_by_ci() -> set[str]:
    """Return the Debian packages that .ci/run can add, with the multilib of Debian bookworm's gcc."""
    script = (ROOT / ".ci" / "run").read_text()
    script = re.sub(r'"gcc-\$\(.*?\)-multilib"', "gcc-12-multilib", script)
    added = re.findall(r"missing\+=\(([\w +.-]+)\)", script) + re.findall(r"for tool in ([a-z ]+);", script)
    assert script.count("missing+=(") == len(added)
    return set(" ".join(added).split())


def test_the_container_has_the_packages_of_ci() -> None:
    """Compare the container's packages with CI's; it adds git and Python's C headers."""
    dockerfile = (ROOT / ".devcontainer" / "Dockerfile").read_text()
    listed = re.search(r"--no-install-recommends \\\n(.*?)&&", dockerfile, re.DOTALL)
    assert listed
    assert set(listed[1].replace("\\", "").split()) - {"git", "python3-dev"} == installed_by_ci()
    assert "RUN make generate" in dockerfile
    assert 'CMD ["make", "test"]' in dockerfile
    json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text())


def test_the_citation_names_the_journal() -> None:
    """Look for the journal's DOI wherever the archive's number is given."""
    assert "doi: 10.1177/02783649251393332" in (ROOT / "CITATION.cff").read_text()
    files = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "*.md", "*.py", "*.cff"], capture_output=True, text=True, check=True
    ).stdout.split()
    for file in files:
        text = (ROOT / file).read_text()
        if re.search(r"2503\.06802", text) and file != "tests/house/test_release.py":
            assert "10.1177/02783649251393332" in text, file  # the journal's DOI


@pytest.mark.parametrize("target", ["lint", "check-generated", "generate", "test"])
def test_hooks_and_workflow_call_targets_that_exist(target: str) -> None:
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)
    named = [ROOT / ".pre-commit-config.yaml", ROOT / ".devcontainer" / "Dockerfile", ROOT / ".ci" / "run"]
    assert any(re.search(rf"make .*\b{target}\b|make {target}", file.read_text()) for file in named)


def test_the_workflow_runs_what_ci_runs() -> None:
    """Linux calls .ci/run and nothing else; each command of the other systems exists: extra, options, test."""
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())["jobs"]
    commands = {name: [step["run"] for step in job["steps"] if "run" in step] for name, job in jobs.items()}
    assert commands["linux"] == [".ci/run"]
    assert os.access(ROOT / ".ci" / "run", os.X_OK)
    install, *steps = map(shlex.split, commands["elsewhere"])
    assert install[:2] == ["pip", "install"]
    (extra,) = re.fullmatch(r"\.\[([\w-]+)\]", install[2]).groups()  # type: ignore[union-attr]
    assert re.search(rf"^{extra} = ", (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    folder = ""
    for program, *words in steps:
        if program == "stiffgen":
            options = parser().parse_args(words)
            folder = f"{options.output}/iiwa14" if words[0] == "generate" else folder
            assert words[0] != "verify" or words[1] == folder
        else:
            assert [program, *words[:2]] == ["python", "-m", "pytest"]
            assert (ROOT / words[2]).is_file()
    assert {word for step in steps for word in step} >= {"generate", "verify", "pytest"}
    assert {os_name.split("-")[0] for os_name in jobs["elsewhere"]["strategy"]["matrix"]["os"]} == {"macos", "windows"}


def test_the_release_stores_no_token() -> None:
    """Read the release workflow: a tag starts it, and only the approved publishing job may identify."""
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text()
    workflow = yaml.load(text, yaml.BaseLoader)  # "on" is a key
    assert workflow["on"] == {"push": {"tags": ["v*.*.*"]}}
    assert workflow["permissions"] == {"contents": "read"}
    build, publish = workflow["jobs"]["build"], workflow["jobs"]["publish"]
    assert "permissions" not in build
    assert (publish["needs"], publish["environment"], publish["permissions"]) == (
        "build",
        "pypi",
        {"id-token": "write"},
    )
    assert not re.search(r"secrets\.|password|(?<!id-)token:", text)
    (verified,) = (step["run"] for step in build["steps"] if "stiffgen verify" in step.get("run", ""))
    for command in verified.split(" && ")[1:]:
        parser().parse_args(shlex.split(command)[1:])


def test_the_recipe_of_conda_is_that_of_the_package() -> None:
    """Names in conda are lower case; nothing else may differ."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    recipe = yaml.safe_load((ROOT / ".github" / "conda" / "recipe.yaml").read_text())
    told = {"version": stiffgen.__version__, "python_min": project["project"]["requires-python"].removeprefix(">=")}
    assert recipe["context"] == told
    host, run = recipe["requirements"]["host"], recipe["requirements"]["run"]
    assert {each.replace(" ", "") for each in run[1:]} == {each.lower() for each in project["project"]["dependencies"]}
    assert {each.replace(" ", "") for each in host} >= set(project["build-system"]["requires"])
    (program,) = (f"{name} = {place}" for name, place in project["project"]["scripts"].items())
    assert recipe["build"]["python"]["entry_points"] == [program]
    assert recipe["about"]["summary"] == project["project"]["description"]
    assert recipe["about"]["license_file"] == project["project"]["license-files"]
    assert all((ROOT / file).is_file() for file in recipe["tests"][1]["files"]["source"])


def test_the_recipe_for_a_release_names_every_place_of_the_version() -> None:
    steps = (ROOT / "CONTRIBUTING.md").read_text().partition("## Releases")[2].partition("\n## ")[0]
    places = re.findall(r"`([\w./]+\.(?:py|yaml|xml))`", steps)
    assert len(places) >= 3
    for place in places:
        assert stiffgen.__version__ in (ROOT / place).read_text(), place


def test_placeholders_of_addresses_stand_in_one_place() -> None:
    """Whoever owns the name fills in pyproject.toml; the playground's address is where the site puts the page."""
    found = subprocess.run(
        ["git", "-C", str(ROOT), "grep", "-l", "example.org/stiffgen", "--", ":!tests"],
        capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    assert found == ["pyproject.toml"]
    project = (ROOT / "pyproject.toml").read_text()
    (address,) = re.findall(r'^Playground = "(.*)"$', project, re.MULTILINE)
    folder, page = address.rpartition("/docs/")[2].split("/")
    assert f'"{folder}" / "{page}"' in (ROOT / "docs" / "site" / "pages.py").read_text()
