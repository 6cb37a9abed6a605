# SPDX-License-Identifier: MIT
"""MCAP files of ROS 2: sensor_msgs/msg/JointState and geometry_msgs/msg/WrenchStamped, matched by time stamp."""

from __future__ import annotations

import io
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stderr
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from stiffgen.core.errors import RecordingError, listed, printable, shell_word
from stiffgen.lab.analyze.recording import Block, Columns, Recording, RecordingRequest, RowProblem, extra

_JOINTS = "sensor_msgs/msg/JointState"
_WRENCH = "geometry_msgs/msg/WrenchStamped"
_FIRST_MESSAGES = 1000
_LATENESS = 1_000_000_000  # [ns] largest delay of a wrench in the file behind its stamp
_PURPOSE = "reading MCAP"

Stamped = tuple[int, tuple[float, ...]]


@dataclass(frozen=True)
class McapPartition:
    """A whole file, read from front to back, since wrenches are matched in the order of the log."""

    path: Path
    joints: tuple[str, ...]
    q_topic: str
    wrench_topic: str
    tolerance: int
    messages: int

    @property
    def work(self) -> float:
        """Return the number of messages with joint positions."""
        return float(self.messages)

    def blocks(self, most: int) -> Iterator[Block]:
        """Yield one row per message with joint positions, with the wrench nearest in time."""
        row = 0
        matches = _matched(self._messages(), self.tolerance)
        while batch := list(islice(matches, most)):
            values = np.full((len(batch), 1 + len(self.joints) + 6), np.nan)
            missing = np.zeros(values.shape, dtype=bool)
            problems = {}
            for index, ((stamp, positions), wrench) in enumerate(batch):
                values[index, 0] = stamp * 1e-9
                values[index, 1 : 1 + len(positions)] = positions
                if not positions:
                    problems[index] = RowProblem("missing value", "the message lacks some of the joints")
                elif wrench is None:
                    text = f"no wrench within {self.tolerance * 1e-9:g} s of the joint positions"
                    problems[index] = RowProblem("no wrench in time", text)
                else:
                    values[index, -6:] = wrench
            yield Block(np.arange(row, row + len(batch)), values, missing, problems, work=len(batch))
            row += len(batch)

    def _messages(self) -> Iterator[tuple[bool, Stamped]]:
        """Yield (is_wrench, (stamp [ns], numbers)) in the order of the log; no numbers if joints are absent."""
        with self.path.open("rb") as file:
            for topic, stamp, message in _decoded(file, [self.q_topic, self.wrench_topic]):
                if topic == self.wrench_topic:
                    f, m = message.wrench.force, message.wrench.torque
                    yield True, (stamp, (f.x, f.y, f.z, m.x, m.y, m.z))
                    continue
                positions = _positions(message, self.joints)
                if positions is not None:
                    yield False, (stamp, positions)


def _positions(message: Any, joints: tuple[str, ...]) -> tuple[float, ...] | None:
    """Return the positions of the joints; () if some are absent, None if all are (another publisher's message)."""
    names = list(message.name) or list(joints)  # some drivers leave the names out
    present = dict(zip(names, message.position, strict=False))
    if not any(joint in present for joint in joints):
        return None
    found = [present[joint] for joint in joints if joint in present]
    return tuple(found) if len(found) == len(joints) else ()


def _matched(
    messages: Iterator[tuple[bool, Stamped]], tolerance: int
) -> Iterator[tuple[Stamped, tuple[float, ...] | None]]:
    """Yield joint positions with the wrench nearest in time; ``_LATENESS`` bounds the messages in memory."""
    waiting: deque[Stamped] = deque()  # joint positions whose wrench may still come
    wrenches: deque[Stamped] = deque()
    newest = 0  # [ns]
    for is_wrench, stamped in messages:
        (wrenches if is_wrench else waiting).append(stamped)
        newest = max(newest, stamped[0])
        # a later wrench is there, or none in time will come
        while waiting and (
            (wrenches and wrenches[-1][0] >= waiting[0][0]) or newest - waiting[0][0] > tolerance + _LATENESS
        ):
            joints = waiting.popleft()
            yield joints, _nearest(wrenches, joints[0], tolerance)
        while not waiting and wrenches and newest - wrenches[0][0] > tolerance + _LATENESS:
            wrenches.popleft()  # too old for joint positions to come
    for joints in waiting:
        yield joints, _nearest(wrenches, joints[0], tolerance)


def _nearest(wrenches: deque[Stamped], stamp: int, tolerance: int) -> tuple[float, ...] | None:
    """Return the wrench nearest to a time; drop those before the last one that is not later."""
    while len(wrenches) > 1 and wrenches[1][0] <= stamp:
        wrenches.popleft()
    best = min(islice(wrenches, 2), key=lambda wrench: abs(wrench[0] - stamp), default=None)
    return best[1] if best is not None and abs(best[0] - stamp) <= tolerance else None


def _decoded(file: BinaryIO, topics: list[str]) -> Iterator[tuple[str, int, Any]]:
    """Yield (topic, stamp [ns], message); the time of logging replaces a missing stamp."""
    factory = extra("mcap_ros2.decoder", _PURPOSE).DecoderFactory()
    factory.decoder_for = partial(_quietly, factory.decoder_for)
    reader = extra("mcap.reader", _PURPOSE).make_reader(file, validate_crcs=True, decoder_factories=[factory])
    for _, channel, message, decoded in reader.iter_decoded_messages(topics=topics):
        stamp = decoded.header.stamp.sec * 1_000_000_000 + decoded.header.stamp.nanosec
        yield channel.topic, stamp or message.log_time, decoded


def _quietly(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function whose prints are lost: mcap_ros2 prints lines of a damaged schema as they are."""
    with redirect_stderr(io.StringIO()):
        return function(*arguments)


def open_file(path: Path, request: RecordingRequest, progress: Callable[[str], None]) -> Recording:
    """Find the two topics in the file's summary, and the joints in the first messages."""
    progress(f"reading the summary of {path.name}")
    if request.wrench is not None or request.time is not None:
        raise RecordingError("--wrench and --time-column do not apply to MCAP; choose its topic with --topic")
    with path.open("rb") as file:
        summary = extra("mcap.reader", _PURPOSE).make_reader(file).get_summary()
        if summary is None or summary.statistics is None:
            raise RecordingError(
                f"{path}: has no summary; the recorder did not close it: repair it with 'mcap recover'"
            )
        counts = summary.statistics.channel_message_counts
        topics: dict[str, str] = {}
        messages: dict[str, int] = {}
        for number, channel in summary.channels.items():
            schema = summary.schemas.get(channel.schema_id)
            topics[channel.topic] = schema.name if schema else "no type"
            messages[channel.topic] = messages.get(channel.topic, 0) + counts.get(number, 0)
        _check_topics(path, topics, request.topics)
        q_topic, wrench_topic = (_topic(path, topics, kind, request.topics) for kind in (_JOINTS, _WRENCH))
        joints = ((request.q,) if isinstance(request.q, str) else request.q) or request.joints
        if len(joints) != request.dof:
            raise RecordingError(
                f"--q: {len(joints)} names, but the robot has {request.dof} joint positions; MCAP files have no "
                "columns with a prefix"
            )
        file.seek(0)
        _check_joints(path, file, q_topic, joints)
        file.seek(0)
        frame = next((m.header.frame_id for _, _, m in _decoded(file, [wrench_topic])), "")
    tolerance = round(request.tolerance * 1e9)
    whole = McapPartition(path, joints, q_topic, wrench_topic, tolerance, messages[q_topic])
    columns = Columns("time", joints, tuple(f"{part}.{axis}" for part in ("force", "torque") for axis in "xyz"))
    note = f"Wrenches on {printable(wrench_topic)}: frame '{printable(str(frame))}', used without conversion."
    return Recording(path, columns, (whole,), notes=(note,))


def _check_topics(path: Path, topics: Mapping[str, str], chosen: tuple[str, ...]) -> None:
    for topic in chosen:
        if topics.get(topic) not in (_JOINTS, _WRENCH):
            raise RecordingError(
                f"{path}: --topic {shell_word(topic)}: is no topic of type {_JOINTS} or {_WRENCH}; {_listing(topics)}"
            )


def _topic(path: Path, topics: Mapping[str, str], kind: str, chosen: tuple[str, ...]) -> str:
    """Return the topic of a type: the chosen one, or the only one."""
    fitting = sorted(topic for topic, type_name in topics.items() if type_name == kind)
    wanted = [topic for topic in fitting if topic in chosen] or fitting
    if len(wanted) == 1:
        return wanted[0]
    if wanted:
        raise RecordingError(f"{path}: has several topics of type {kind}; choose one with --topic: {listed(wanted)}")
    raise RecordingError(f"{path}: has no topic of type {kind}; {_listing(topics)}")


def _listing(topics: Mapping[str, str]) -> str:
    return "it has " + listed([f"{topic} ({kind})" for topic, kind in sorted(topics.items())])


def _check_joints(path: Path, file: BinaryIO, topic: str, joints: tuple[str, ...]) -> None:
    """Refuse a topic in whose first messages some of the joints do not occur; they may lie in different messages."""
    seen: dict[str, None] = {}
    for _, _, message in islice(_decoded(file, [topic]), _FIRST_MESSAGES):
        seen |= dict.fromkeys(message.name or (joints if len(message.position) == len(joints) else ()))
        if all(joint in seen for joint in joints):
            return
    absent = [joint for joint in joints if joint not in seen]
    raise RecordingError(
        f"{path}: no message on {printable(topic)} has joint {listed(absent)}; the messages have "
        f"{listed(list(seen), 40) or 'none'}. Name the joints in the order of q with --q, separated by commas"
    )
