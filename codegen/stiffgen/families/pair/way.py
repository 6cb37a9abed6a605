# SPDX-License-Identifier: MIT
"""Pairs of tips by their names, and the serial chain from one tip to the other.

A spring between two tips depends on the pose of the second tip seen from the first. The chain is therefore rooted at
the first tip: a joint on the way to the last shared link is reversed (its axis is negated, and its frame follows from
the inverse of its origin), the others stay as they are. Joints that carry both tips, and a floating base, are not on
the way: their torques are zero, and so are their rows of the joint stiffness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

from stiffgen.core.errors import ChainError, listed, printable
from stiffgen.core.names import identifier
from stiffgen.core.robot.chain import Chain, Joint, Tip
from stiffgen.core.robot.geometry import Matrix, Pose, Vector
from stiffgen.core.symbolic.kernel import Span

KINDS = ("pair", "pair_bounded", "absolute", "bimanual")
"""Groups of a robot with one pair."""


@dataclass(frozen=True)
class TipPair:
    """Two tips with a spring between them; ``name`` is the word behind the group's (:func:`names_of`)."""

    first: Tip
    second: Tip
    name: str

    def group(self, kind: str) -> str:
        """Return the group of kernels of a kind: "pair", or "pair_left_right" where the robot has several pairs."""
        return "_".join(filter(None, (kind, self.name)))

    @property
    def note(self) -> str:
        """Sentence for callers: which tips A and B are."""
        return f"A is {self.first.name}, B is {self.second.name}."

    @property
    def on_the_way(self) -> Span:
        """Joints from the first tip to the second, rooted at the first tip."""
        title = f"{self.second.link} seen from {self.first.link}, which takes the base's place"
        name = self.group("pair")
        return Span(name, title, lambda chain: between(chain, self.first, self.second, name))

    @property
    def from_the_base(self) -> Span:
        """Joints from the base to both tips."""
        title = f"{self.first.link} and {self.second.link}"
        return Span(self.group("pair_of_tips"), title, lambda chain: chain.branch(self.first, self.second))


def names_of(words: Sequence[str]) -> tuple[str, ...]:
    """Return what follows the groups' names for words A:B: "" for an only one, else both words, "left_right".

    Raises:
        ChainError: a word is not A:B, or two words have one name.

    """
    for word in words:
        if not all(word.split(":")) or word.count(":") != 1:
            raise ChainError(
                f"--pair {printable(word)}: is not A:B with two tips A and B; for a link with ':' in its name, give "
                "the name of the tip's functions"
            )
    names = ["_".join(map(identifier, word.split(":"))) for word in words]
    twice = [word for word, name in zip(words, names, strict=True) if names.count(name) > 1]
    if twice:
        raise ChainError(f"--pair {printable(twice[0])}: two pairs have the name {names[words.index(twice[0])]}")
    return tuple(names) if len(names) > 1 else ("",) * len(names)


def pairs_of(chain: Chain, words: Sequence[str]) -> tuple[TipPair, ...]:
    """Return the pairs that words A:B name, by the tips' links or names.

    Raises:
        ChainError: a word names no two tips, a pair occurs twice, or a closed loop lies between its tips.

    """
    pairs = [_pair(chain, word, name) for word, name in zip(words, names_of(words), strict=True)]
    for number, (word, pair) in enumerate(zip(words, pairs, strict=True)):
        if any({pair.first, pair.second} == {other.first, other.second} for other in pairs[:number]):
            raise ChainError(f"--pair {printable(word)}: these two tips have a pair already; leave one of the two out")
        taken = {tip.name for tip in chain.tips} & {pair.group(kind) for kind in KINDS}
        if taken:
            raise ChainError(
                f"--pair {printable(word)}: its group {taken.pop()} has the name of a tip; rename the link"
            )
    return tuple(pairs)


def _pair(chain: Chain, word: str, name: str) -> TipPair:
    """Return the pair that a word names."""
    if len(chain.tips) < 2:
        raise ChainError(f"--pair {printable(word)}: the robot has one tip; give two with --tip")
    first, second = (_tip(chain, word, end) for end in word.split(":"))
    if first == second:
        raise ChainError(f"--pair {printable(word)}: names one tip twice; give two of {_known(chain)}")
    pair = TipPair(first, second, name)
    if not any(_parted(chain, first, second)):
        raise ChainError(f"--pair {printable(word)}: no joint moves between the two tips")
    _refuse_loops(chain, word, pair)
    return pair


def _known(chain: Chain) -> str:
    return listed([tip.link for tip in chain.tips])


def _tip(chain: Chain, word: str, end: str) -> Tip:
    """Return the tip of a link or name, the link's first."""
    found = [tip for tip in chain.tips if tip.link == end] + [tip for tip in chain.tips if tip.name == end]
    if not found:
        raise ChainError(f"--pair {printable(word)}: {printable(end)} is no tip; tips are {_known(chain)}")
    return found[0]


def _refuse_loops(chain: Chain, word: str, pair: TipPair) -> None:
    """Raise ChainError for a closed loop among the joints between the tips: they move with the loop's other joints."""
    between_tips = [chain.joints[k] for part in _parted(chain, pair.first, pair.second) for k in part]
    for loop in chain.loops:
        in_loop = {joint.coordinate for end in (loop.first, loop.second) for joint in end.joints}
        shared = [joint.name for joint in between_tips if joint.coordinate in in_loop]
        if shared:
            raise ChainError(
                f"--pair {printable(word)}: joint '{printable(shared[0])}' between the tips belongs to the closed loop "
                f"'{printable(loop.name)}', and pairs have no functions in motor coordinates; choose tips on the same "
                "side of the loop, or leave the loop open"
            )


def _parted(chain: Chain, first: Tip, second: Tip) -> tuple[list[int], list[int]]:
    """Return the joints of each tip's path that the other one's has not, outwards."""
    paths = []
    for tip in (first, second):
        path, index = list[int](), tip.joint
        while index >= 0:
            path.insert(0, index)
            index = chain.joints[index].parent
        paths.append(path)
    one, other = paths
    return [k for k in one if k not in other], [k for k in other if k not in one]


def _pose(rotation: Matrix, translation: Vector) -> Pose:
    return Pose.translated(translation) @ Pose.turned(rotation)


@cache
def between(chain: Chain, first: Tip, second: Tip, name: str) -> Chain:
    """Return the serial chain from the first tip to the second, with the robot's coordinates and no tool at run time.

    ``name`` is that of the chain's tip, for internal functions.
    """
    # joints from the first tip towards the base, walked backwards, and from there out to the second tip
    inwards, outwards = _parted(chain, first, second)
    joints = list[Joint]()
    place = _pose(first.rotation, first.translation).inverse()  # of the next joint's frame, in the frame before it
    for index in reversed(inwards):
        joint = chain.joints[index]
        joints.append(_placed(joint, place, parent=len(joints) - 1, sign=-1))
        place = _pose(joint.rotation, joint.translation).inverse()
    for index in outwards:
        joint = chain.joints[index]
        place = place @ _pose(joint.rotation, joint.translation)
        joints.append(_placed(joint, place, parent=len(joints) - 1, sign=1))
        place = Pose.identity()
    rotation, translation = (place @ _pose(second.rotation, second.translation)).rounded()
    tip = Tip(second.link, name, len(joints) - 1, rotation, translation)
    return replace(chain, base=first.link, tips=(tip,), joints=tuple(joints), runtime_tool=False, loops=())


def _placed(joint: Joint, place: Pose, *, parent: int, sign: int) -> Joint:
    """Return a joint at another place behind another parent; a joint that is walked backwards has the sign -1."""
    rotation, translation = place.rounded()
    x, y, z = (sign * each if each else 0.0 for each in joint.axis)  # never -0.0
    return replace(joint, axis=(x, y, z), parent=parent, rotation=rotation, translation=translation)
