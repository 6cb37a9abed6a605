# SPDX-License-Identifier: MIT
"""Open decisions of a project: from options, from questions at a terminal, or the only possible answer."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from stiffgen.cli.survey import TipSurvey, survey_tip
from stiffgen.core.errors import StiffgenError, listed, printable
from stiffgen.core.robot.chain import Tool
from stiffgen.core.robot.description import Description
from stiffgen.core.robot.selection import possible_tips, suggested_tips
from stiffgen.core.symbolic.choices import KINDS

CONTROLLERS = {
    "impedance": "the generated controller: energy account, limits, watches, faults",
    "ros2": "a ros2_control package around the generated controller",
    "spring": "a law of your own to edit: the torque of a spring, and damping in the joints",
}
"""Laws that can close the loop of a project."""
GENERATED = ("impedance", "ros2")
"""Those that are the generated controller."""
_MOST_TIPS = 100

Ask = Callable[[str], str]
"""Function that shows a question and returns the answer, without its end of line."""


@dataclass(frozen=True)
class Answers:
    """Decisions: links, tool (None: none), kind of spring, controller, and whether the file's masses are used.

    ``friction`` is the coulomb_friction of a generated controller, per joint [N m or N]; empty: 0, none is fed forward.
    """

    tip: str
    base: str
    tool: Tool | None
    spring: str
    controller: str
    masses: bool = True
    friction: tuple[float, ...] = ()


def decide(
    description: Description,
    ask: Ask | None = None,
    *,
    tip: str | None = None,
    base: str | None = None,
    tool: Tool | None = None,
    spring: str | None = None,
    controller: str | None = None,
    masses: bool = True,
) -> Answers:
    """Decide what the options leave open (None).

    Args:
        description: description of the robot.
        ask: function that asks at the terminal; None without a terminal.
        tip: link that touches things.
        base: first link of the chain.
        tool: tool on the tip link.
        spring: kind of spring.
        controller: control law.
        masses: False ignores the file's masses; then the controller can only be the spring.

    Raises:
        StiffgenError: something is ambiguous and nobody can answer, or choices exclude each other.
        ChainError: there is no such tip or base.

    """
    if not masses and controller in GENERATED:
        raise StiffgenError(
            f"--controller {controller} needs masses; leave out --no-masses, or use --controller spring"
        )
    survey = _tip(description, tip, base, masses, ask)
    base = base or _chosen(
        ask, f"Base link: first link of the chain [{printable(survey.base)}]", survey.base, description.links
    )
    tool = tool or _tool(ask, survey.tip)
    if controller is None:
        controller = _chosen(ask, _menu("Controller", CONTROLLERS), "impedance", CONTROLLERS) if masses else "spring"
    if controller in GENERATED:
        if spring not in (None, "trace"):
            raise StiffgenError(
                f"spring {spring}: the impedance controller has the spring 'trace'; "
                f"choose --controller spring={spring}, or the spring 'trace'"
            )
        joints = survey.coordinates if base == survey.base else survey_tip(description, survey.tip, base).coordinates
        return Answers(survey.tip, base, tool, "trace", controller, friction=_friction(ask, len(joints)))
    spring = spring or _chosen(ask, f"Spring: {', '.join(KINDS)} [trace]", "trace", KINDS)
    return Answers(survey.tip, base, tool, spring, controller, masses)


def _tip(description: Description, tip: str | None, base: str | None, masses: bool, ask: Ask | None) -> TipSurvey:
    """Return the survey of the chosen tip, the only leaf, or the answer; refuse a tip whose chain has a hindrance."""
    if tip is not None:
        survey = survey_tip(description, tip, base, masses)
        if survey.hindrance and survey.coordinates:  # only its masses are refused: say so before any question
            raise StiffgenError(f"{description.file}: tip '{printable(survey.tip)}': {survey.hindrance}")
        return survey
    tips = possible_tips(description, base)
    good, refused = _usable(description, [survey_tip(description, link, base, masses) for link in tips[:_MOST_TIPS]])
    if len(tips) == 1:  # as 'generate' chooses
        return good[0]
    if ask is None:
        names = [link for link in suggested_tips(description, base) if link not in refused]
        raise StiffgenError(
            f"{description.file}: several links could be the tip, and there is no terminal to ask at; "
            f"choose one with --tip: {listed(names)}"
        )
    lines = {survey.tip: f"{len(survey.coordinates)} joints from {printable(survey.base)}" for survey in good}
    longest = max(good, key=lambda survey: len(survey.coordinates)).tip
    menu = _menu("Tip: the link that touches things; one of these, or any other", lines, longest)
    return survey_tip(description, _chosen(ask, menu, longest, description.links), base, masses)


def _usable(description: Description, surveys: list[TipSurvey]) -> tuple[list[TipSurvey], set[str]]:
    """Return the surveys of tips with a usable chain, and the other tips; refuse a file without a usable chain."""
    good = [survey for survey in surveys if survey.coordinates and not survey.hindrance]
    if good:
        return good, {survey.tip for survey in surveys} - {survey.tip for survey in good}
    for survey in surveys:
        if survey.hindrance:
            raise StiffgenError(f"{description.file}: tip '{printable(survey.tip)}': {survey.hindrance}")
    raise StiffgenError(f"{description.file}: no leaf link has a usable chain; 'stiffgen inspect' names the reasons")


def _menu(title: str, lines: dict[str, str], default: str | None = None) -> str:
    shown = "".join(f"\n  {printable(name)}: {text}" for name, text in lines.items())
    return f"{title}{shown}\n[{printable(default or next(iter(lines)))}]"


def _chosen(ask: Ask | None, question: str, default: str, allowed: Iterable[str]) -> str:
    """Return one of the names; the default without a terminal or after an empty answer."""
    names = list(allowed)
    while ask is not None:
        answer = ask(question).strip() or default
        if answer in names:
            return answer
        question = f"'{printable(answer)}' is not one of them: {listed(names)}\n[{printable(default)}]"
    return default


def _tool(ask: Ask | None, tip: str) -> Tool | None:
    """Return a tool at the answered origin, without mass; None without a terminal or after an empty answer."""
    question = f"Tool: its origin in the axes of {printable(tip)}, as x y z [m]; nothing without a tool []"
    while ask is not None:
        answer = ask(question).split()
        if not answer:
            return None
        try:
            x, y, z = map(float, answer)
        except ValueError:
            question = "Three numbers [m], such as 0 0 0.2, or nothing []"
        else:
            return Tool(xyz=(x, y, z))
    return None


def _friction(ask: Ask | None, count: int) -> tuple[float, ...]:
    """Return the answered coulomb_friction of each joint; empty without a terminal or after an empty answer."""
    question = (
        f"Friction to feed forward: coulomb_friction of {count} joints [N m or N], as 'stiffgen measure --friction' "
        "prints it; nothing where it is not known []"
    )
    while ask is not None:
        answer = ask(question).replace(",", " ").split()
        if not answer:
            return ()
        try:
            values = tuple(map(float, answer))
        except ValueError:
            values = ()
        if len(values) == count and all(0 <= each < 1e6 for each in values):
            return values
        question = f"{count} numbers from 0 [N m or N], or nothing []"
    return ()
