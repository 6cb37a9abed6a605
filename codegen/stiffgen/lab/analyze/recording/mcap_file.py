# SPDX-License-Identifier: MIT
"""MCAP files of ROS 2: sensor_msgs/msg/JointState and geometry_msgs/msg/WrenchStamped, matched by time stamp."""

from __future__ import annotations

import io
import struct
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from stiffgen.core.errors import RecordingError, listed, printable, shell_word
from stiffgen.lab.analyze.recording import Block, Columns, Recording, RecordingRequest, RowProblem, extra
from stiffgen.lab.analyze.recording.stamps import LATENESS, Match, Message, Unwrapped, jumps, matched

_JOINTS = "sensor_msgs/msg/JointState"
_WRENCH = "geometry_msgs/msg/WrenchStamped"
_FIRST_MESSAGES = 1000
_LARGEST_CHUNK = 1 << 28  # [bytes]; recorders write chunks of some megabytes
_NANOSECONDS = 1_000_000_000
"""Nanoseconds per second."""
_ENCAPSULATION = 4
"""Bytes before a message's fields; a bit of the second one tells the byte order."""
_PURPOSE = "reading MCAP"


@dataclass(frozen=True)
class McapPartition:
    """A whole file, read from front to back, since wrenches are matched in the order of the log.

    ``set_back`` tells that the recorder's clock was set back: the order of the log is then that of the file.
    """

    path: Path
    joints: tuple[str, ...]
    q_topic: str
    wrench_topic: str
    tolerance: int
    messages: int
    set_back: bool

    @property
    def work(self) -> float:
        """Return the number of messages with joint positions."""
        return float(self.messages)

    def blocks(self, most: int) -> Iterator[Block]:
        """Yield one row per message with joint positions, with the wrench nearest in time."""
        row = 0
        matches = matched(self._messages(), self.tolerance)
        while batch := list(islice(matches, most)):
            values = np.full((len(batch), 1 + len(self.joints) + 6), np.nan)
            missing = np.zeros(values.shape, dtype=bool)
            problems = {}
            for index, match in enumerate(batch):
                positions = match.joints.numbers
                values[index, 0] = match.joints.stamp * 1e-9
                values[index, 1 : 1 + len(positions)] = positions
                if match.wrench is not None:
                    values[index, -6:] = match.wrench
                if (problem := self._problem(match)) is not None:
                    problems[index] = problem
            yield Block(np.arange(row, row + len(batch)), values, missing, problems, work=len(batch))
            row += len(batch)

    def _problem(self, match: Match) -> RowProblem | None:
        """Return why a row cannot be used."""
        if not match.joints.numbers:
            return RowProblem("missing value", "the message lacks some of the joints")
        if match.wrench is not None:
            return None
        if match.away is not None and abs(match.away) > LATENESS:
            direction = "later" if match.away > 0 else "earlier"
            text = (
                f"the wrenches logged beside the joint positions are stamped {abs(match.away) * 1e-9:g} s {direction}"
            )
            return RowProblem("stamp of another time", text)
        text = f"no wrench within {self.tolerance * 1e-9:g} s of the joint positions"
        return RowProblem("no wrench in time", text)

    def _messages(self) -> Iterator[Message]:
        """Yield messages in the order of the log; no numbers if joints are absent."""
        topics = (self.q_topic, self.wrench_topic)
        unwrapped = {topic: Unwrapped(self.tolerance) for topic in topics}
        with self.path.open("rb") as file:
            for topic, logged, stamp, message in _decoded(file, topics, in_file_order=self.set_back):
                time = unwrapped[topic](logged) if self.set_back else logged
                if topic == self.wrench_topic:
                    f, m = message.wrench.force, message.wrench.torque
                    yield Message(True, time, stamp, (f.x, f.y, f.z, m.x, m.y, m.z))
                    continue
                positions = _positions(message, self.joints)
                if positions is not None:
                    yield Message(False, time, stamp, positions)


def _positions(message: Any, joints: tuple[str, ...]) -> tuple[float, ...] | None:
    """Return the positions of the joints; () if some are absent, None if all are (another publisher's message)."""
    names = list(message.name) or list(joints)  # some drivers leave the names out
    present = dict(zip(names, message.position, strict=False))
    if not any(joint in present for joint in joints):
        return None
    found = [present[joint] for joint in joints if joint in present]
    return tuple(found) if len(found) == len(joints) else ()


def _decoded(
    file: BinaryIO, topics: Sequence[str], *, in_file_order: bool = False
) -> Iterator[tuple[str, int, int, Any]]:
    """Yield (topic, logged [ns], stamp [ns], message); the time of logging replaces a missing stamp."""
    factory = extra("mcap_ros2.decoder", _PURPOSE).DecoderFactory()
    factory.decoder_for = partial(_quietly, factory.decoder_for)
    reader = extra("mcap.reader", _PURPOSE).make_reader(file, validate_crcs=True, decoder_factories=[factory])
    for _, channel, message, decoded in reader.iter_decoded_messages(topics=topics, log_time_order=not in_file_order):
        stamp = decoded.header.stamp.sec * _NANOSECONDS + decoded.header.stamp.nanosec
        yield channel.topic, message.log_time, stamp or message.log_time, decoded


@dataclass(frozen=True)
class _Clocks:
    """What the clocks did in a recording: whether the recorder's was set back, and sentences about the stamps."""

    set_back: bool
    notes: tuple[str, ...]


def _times(file: BinaryIO, topics: Sequence[str]) -> dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Return the logged times and the stamps by topic, in the order of the file; messages are not decoded [ns]."""
    times = {topic: (array("q"), array("q")) for topic in topics}
    reader = extra("mcap.reader", _PURPOSE).make_reader(file)
    for _, channel, message in reader.iter_messages(topics=topics, log_time_order=False):
        logged, stamps = times[channel.topic]
        logged.append(message.log_time)
        stamps.append(_stamp(message.data) or message.log_time)
    return {
        topic: (np.array(logged, dtype=np.int64), np.array(stamps, dtype=np.int64))
        for topic, (logged, stamps) in times.items()
    }


def _stamp(data: bytes) -> int:
    """Return the stamp [ns] of a message: both types begin with their header, and that with seconds and nanoseconds."""
    is_little = data[1] & 1
    second, nanosecond = struct.unpack_from("<iI" if is_little else ">iI", data, _ENCAPSULATION)
    return int(second) * _NANOSECONDS + int(nanosecond)


def _clocks(file: BinaryIO, topics: Sequence[str], tolerance: int) -> _Clocks:
    """Find what the clocks of recorder and publishers did; the tolerance is in ns."""
    times, notes = _times(file, topics), []
    back = max(int(np.sum(np.diff(logged) < -tolerance)) for logged, _ in times.values())
    if back:
        notes.append(
            f"The recorder's clock was set back ({back} times): messages are matched in the order of the file."
        )
    for topic, (logged, stamps) in times.items():
        if back:
            unwrapped = Unwrapped(tolerance)
            ordered, of_stamps = np.array([unwrapped(time) for time in logged.tolist()], dtype=np.int64), stamps
        else:
            order = np.argsort(logged, kind="stable")
            ordered, of_stamps = logged[order], stamps[order]
        found, first = jumps(ordered, of_stamps, tolerance)
        if len(found):
            notes.append(
                f"Time stamps on {printable(topic)} jump {len(found)} times, first by {first:g} s at message "
                f"{found[0]}: the publisher's clock."
            )
    return _Clocks(bool(back), tuple(notes))


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
        topics, messages = _topics(path, file)
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
        frame = next((decoded.header.frame_id for *_, decoded in _decoded(file, [wrench_topic])), "")
        progress(f"reading the times in {path.name}")
        tolerance = round(request.tolerance * _NANOSECONDS)
        file.seek(0)
        clocks = _clocks(file, (q_topic, wrench_topic), tolerance)
    whole = McapPartition(
        path=path,
        joints=joints,
        q_topic=q_topic,
        wrench_topic=wrench_topic,
        tolerance=tolerance,
        messages=messages[q_topic],
        set_back=clocks.set_back,
    )
    columns = Columns("time", joints, tuple(f"{part}.{axis}" for part in ("force", "torque") for axis in "xyz"))
    note = f"Wrenches on {printable(wrench_topic)}: frame '{printable(str(frame))}', used without conversion."
    return Recording(path, columns, (whole,), notes=(note, *clocks.notes))


def _topics(path: Path, file: BinaryIO) -> tuple[dict[str, str], dict[str, int]]:
    """Return the type of each topic, and the number of its messages, from the summary at the end of a file.

    Raises:
        RecordingError: the file has no summary, or a chunk that is too large.

    """
    summary = extra("mcap.reader", _PURPOSE).make_reader(file).get_summary()
    if summary is None or summary.statistics is None:
        raise RecordingError(f"{path}: has no summary; the recorder did not close it: repair it with 'mcap recover'")
    _check_chunks(path, summary.chunk_indexes)
    counts = summary.statistics.channel_message_counts
    types: dict[str, str] = {}
    messages: dict[str, int] = {}
    for number, channel in summary.channels.items():
        schema = summary.schemas.get(channel.schema_id)
        types[channel.topic] = schema.name if schema else "no type"
        messages[channel.topic] = messages.get(channel.topic, 0) + counts.get(number, 0)
    return types, messages


def _check_chunks(path: Path, chunks: Sequence[Any]) -> None:
    """Refuse a file with a chunk that would fill the memory: chunks are unpacked whole."""
    largest = max((chunk.uncompressed_size for chunk in chunks), default=0)
    if largest > _LARGEST_CHUNK:
        raise RecordingError(
            f"{path}: has a chunk of {largest / 2**30:.1f} GiB, which is unpacked whole; write it again with chunks "
            f"of at most {_LARGEST_CHUNK >> 20} MiB ('mcap compress --chunk-size')"
        )


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
    for *_, message in islice(_decoded(file, [topic]), _FIRST_MESSAGES):
        seen |= dict.fromkeys(message.name or (joints if len(message.position) == len(joints) else ()))
        if all(joint in seen for joint in joints):
            return
    absent = [joint for joint in joints if joint not in seen]
    raise RecordingError(
        f"{path}: no message on {printable(topic)} has joint {listed(absent)}; the messages have "
        f"{listed(list(seen), 40) or 'none'}. Name the joints in the order of q with --q, separated by commas"
    )
