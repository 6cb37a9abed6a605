# SPDX-License-Identifier: MIT
"""Define the FRI messages of the versions 1.15, 2.5 and 2.7 in one table.

The schema is not compiled from a file: :data:`SCHEMA` lists every field once, and :class:`Protocol` builds the messages
of one version from it at run time. Field numbers and encodings are facts about the wire; nothing here is taken from
KUKA's sources.

On the wire a datagram is one message. Until 2.5 it is bare; from 2.7 on it is framed by its length before it and its
CRC-32 behind it, both little-endian, 32 bits. Joint values are sent unpacked, other arrays of numbers packed; both are
read.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError, Message
from numpy.typing import NDArray

VERSIONS = ("1.15", "2.5", "2.7")
MONITORING_IDENTIFIER = 0x245142
COMMAND_IDENTIFIER = 0x34001
JOINTS = 7
MOST_BYTES = 1500
"""Size of the buffers on both sides; no datagram may be longer."""


class SessionState(IntEnum):
    """State of a session; the robot alone decides."""

    IDLE = 0
    MONITORING_WAIT = 1
    MONITORING_READY = 2
    COMMANDING_WAIT = 3
    COMMANDING_ACTIVE = 4


class Quality(IntEnum):
    """Quality of the connection as the robot sees it."""

    POOR = 0
    FAIR = 1
    GOOD = 2
    EXCELLENT = 3


class SafetyState(IntEnum):
    """State of the robot's safety controller."""

    NORMAL_OPERATION = 0
    SAFETY_STOP_LEVEL_0 = 1
    SAFETY_STOP_LEVEL_1 = 2
    SAFETY_STOP_LEVEL_2 = 3


class OperationMode(IntEnum):
    """Operation mode: manual reduced, manual high speed, automatic."""

    T1 = 0
    T2 = 1
    AUT = 2


class DriveState(IntEnum):
    """State of a joint's drive."""

    OFF = 0
    TRANSITIONING = 1
    ACTIVE = 2


class ControlMode(IntEnum):
    """Controller that moves the robot."""

    POSITION = 0
    CARTESIAN_IMPEDANCE = 1
    JOINT_IMPEDANCE = 2
    NO_CONTROL = 3


class CommandMode(IntEnum):
    """Quantity that the client commands."""

    NO_COMMAND_MODE = 0
    POSITION = 1
    WRENCH = 2
    TORQUE = 3
    CARTESIAN_POSE = 4


class OverlayType(IntEnum):
    """Motion that the client's commands are added to."""

    NO_OVERLAY = 0
    JOINT = 1
    CARTESIAN = 2


class IOType(IntEnum):
    """Kind of an input or output."""

    BOOLEAN = 0
    DIGITAL = 1
    ANALOG = 2


class IODirection(IntEnum):
    """Direction of an input or output, as the robot sees it."""

    INPUT = 0
    OUTPUT = 1


# message, field, number, label, type; then, if not in all versions, the first letters of the versions that have it.
# Enumerations are int32 here: on the wire they are the same, and a value that a version does not know stays readable.
SCHEMA = """
FRIMonitoringMessage    header                       1 required MessageHeader
FRIMonitoringMessage    robotInfo                    2 optional RobotInfo
FRIMonitoringMessage    monitorData                  3 optional MessageMonitorData
FRIMonitoringMessage    connectionInfo               4 optional ConnectionInfo
FRIMonitoringMessage    ipoData                      5 optional MessageIpoData
FRIMonitoringMessage    requestedTransformations     6 repeated Transformation
FRIMonitoringMessage    endOfMessageData            15 optional MessageEndOf              1.15 2.5
FRICommandMessage       header                       1 required MessageHeader
FRICommandMessage       commandData                  2 optional MessageCommandData
FRICommandMessage       endOfMessageData            15 optional MessageEndOf              1.15 2.5
MessageHeader           messageIdentifier            1 required uint32
MessageHeader           sequenceCounter              2 required uint32
MessageHeader           reflectedSequenceCounter     3 required uint32
ConnectionInfo          sessionState                 1 required int32
ConnectionInfo          quality                      2 required int32
ConnectionInfo          sendPeriod                   3 optional uint32
ConnectionInfo          receiveMultiplier            4 optional uint32
RobotInfo               numberOfJoints               1 optional int32
RobotInfo               safetyState                  2 optional int32
RobotInfo               driveState                   5 repeated int32
RobotInfo               operationMode                6 optional int32
RobotInfo               controlMode                  7 optional int32
MessageMonitorData      measuredJointPosition        1 optional JointValues
MessageMonitorData      measuredTorque               2 optional JointValues
MessageMonitorData      commandedJointPosition       3 optional JointValues               1.15
MessageMonitorData      commandedTorque              4 optional JointValues
MessageMonitorData      externalTorque               5 optional JointValues
MessageMonitorData      externalForce                6 optional CartesianVector           2.7
MessageMonitorData      readIORequest                8 repeated FriIOValue
MessageMonitorData      measuredCartesianPose        9 optional Transformation            2.5 2.7
MessageMonitorData      measuredRedundancyInformation 10 optional RedundancyInformation   2.5 2.7
MessageMonitorData      timestamp                   15 optional TimeStamp
MessageIpoData          jointPosition                1 optional JointValues
MessageIpoData          cartesianPose                2 optional Transformation            2.5 2.7
MessageIpoData          redundancyInformation        3 optional RedundancyInformation     2.5 2.7
MessageIpoData          clientCommandMode           10 optional int32
MessageIpoData          overlayType                 11 optional int32
MessageIpoData          trackingPerformance         12 optional double
MessageCommandData      jointPosition                1 optional JointValues
MessageCommandData      cartesianWrenchFeedForward   2 optional CartesianVector
MessageCommandData      jointTorque                  3 optional JointValues
MessageCommandData      commandedTransformations     4 repeated Transformation
MessageCommandData      writeIORequest               5 repeated FriIOValue
MessageCommandData      cartesianPose                6 optional Transformation            2.5 2.7
MessageCommandData      redundancyInformation        7 optional RedundancyInformation     2.5 2.7
JointValues             value                        1 repeated double
CartesianVector         element                      1 repeated packed_double
TimeStamp               sec                          1 required uint32
TimeStamp               nanosec                      2 required uint32
Transformation          name                         1 required string
Transformation          matrix                       2 repeated packed_double             1.15
Transformation          element                      2 repeated packed_double             2.5 2.7
Transformation          timestamp                    3 optional TimeStamp
FriIOValue              name                         1 required string
FriIOValue              type                         2 required int32
FriIOValue              direction                    3 required int32
FriIOValue              digitalValue                 4 optional uint64
FriIOValue              analogValue                  5 optional double
RedundancyInformation   strategy                     1 required int32                     2.5 2.7
RedundancyInformation   value                        2 required double                    2.5 2.7
MessageEndOf            messageLength                1 optional int32                     1.15 2.5
MessageEndOf            messageChecksum              2 optional Checksum                  1.15 2.5
Checksum                crc32                        1 optional int32                     1.15 2.5
"""


class MessageError(ValueError):
    """A datagram is no message of this version; the text says what is wrong with it, ``kind`` in a word or two."""

    def __init__(self, kind: str, text: str) -> None:
        self.kind = kind
        super().__init__(text)


@dataclass
class IOValue:
    """An input or output of the robot.

    Attributes
    ----------
    name : str
        "Group.Name".
    type : IOType
    direction : IODirection
    value : bool, int or float
        As the type has it.

    """

    name: str
    type: IOType
    direction: IODirection
    value: float


@dataclass
class Monitoring:
    """Content of a monitoring message. Arrays are of shape (7,), rad and N m, unless said; None: not sent.

    ``pose`` is (x, y, z) in mm and a unit quaternion (w, x, y, z), base to tip; ``external_force`` is the wrench (force
    first, N and N m). ``sent_at`` is Unix time in whole nanoseconds.
    """

    state: SessionState = SessionState.IDLE
    quality: Quality = Quality.POOR
    send_period: int = 5
    receive_multiplier: int = 1
    sequence: int = 0
    reflected: int = 0
    safety: SafetyState = SafetyState.NORMAL_OPERATION
    drive: DriveState = DriveState.ACTIVE
    operation: OperationMode = OperationMode.AUT
    control: ControlMode = ControlMode.POSITION
    command_mode: CommandMode = CommandMode.NO_COMMAND_MODE
    overlay: OverlayType = OverlayType.NO_OVERLAY
    position: NDArray[Any] = field(default_factory=lambda: np.zeros(JOINTS))
    torque: NDArray[Any] = field(default_factory=lambda: np.zeros(JOINTS))
    commanded_position: NDArray[Any] = field(default_factory=lambda: np.zeros(JOINTS))
    commanded_torque: NDArray[Any] = field(default_factory=lambda: np.zeros(JOINTS))
    external_torque: NDArray[Any] = field(default_factory=lambda: np.zeros(JOINTS))
    external_force: NDArray[Any] = field(default_factory=lambda: np.zeros(6))
    pose: NDArray[Any] = field(default_factory=lambda: np.array([0.0, 0, 0, 1, 0, 0, 0]))
    redundancy: float = 0.0
    ios: list[IOValue] = field(default_factory=list)
    ipo: NDArray[Any] | None = None
    tracking: float = 0.0
    sent_at: int = 0


@dataclass(frozen=True)
class Command:
    """Content of a command message. ``position`` (7,) rad and ``torque`` (7,) N m are None if not sent."""

    sequence: int
    reflected: int
    position: NDArray[Any] | None
    torque: NDArray[Any] | None
    ios: tuple[IOValue, ...]


def _message_classes(version: str) -> dict[str, type[Message]]:
    """Return the message classes of a version by name, in a pool of their own."""
    types = descriptor_pb2.FieldDescriptorProto
    labels = {"required": types.LABEL_REQUIRED, "optional": types.LABEL_OPTIONAL, "repeated": types.LABEL_REPEATED}
    scalars = {"double": types.TYPE_DOUBLE, "packed_double": types.TYPE_DOUBLE, "int32": types.TYPE_INT32,
               "uint32": types.TYPE_UINT32, "uint64": types.TYPE_UINT64, "string": types.TYPE_STRING}  # fmt: skip
    package = "fri" + version.replace(".", "_")
    file = descriptor_pb2.FileDescriptorProto(name=f"{package}.proto", package=package, syntax="proto2")
    messages: dict[str, Any] = {}
    for message, name, number, label, kind, *versions in map(str.split, SCHEMA.strip().splitlines()):
        if versions and version not in versions:
            continue
        if message not in messages:
            messages[message] = file.message_type.add(name=message)
        row = messages[message].field.add(name=name, number=int(number), label=labels[label])
        if kind in scalars:
            row.type = scalars[kind]
        else:
            row.type, row.type_name = types.TYPE_MESSAGE, f".{package}.{kind}"
        if kind == "packed_double":
            row.options.packed = True
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{package}.{name}")) for name in messages}


class Protocol:
    """Messages of one FRI version to and from datagrams.

    Parameters
    ----------
    version : str
        "1.15", "2.5" or "2.7".

    Raises
    ------
    MessageError
        There is no such version.

    """

    def __init__(self, version: str) -> None:
        """Choose messages and frame of an FRI version."""
        if version not in VERSIONS:
            raise MessageError("version", f"no FRI version '{version}'; there are {', '.join(VERSIONS)}")
        self.version = version
        self.framed = version == "2.7"
        self.cartesian = version != "1.15"
        classes = _message_classes(version)
        self.monitoring_class: Any = classes["FRIMonitoringMessage"]
        self.command_class: Any = classes["FRICommandMessage"]

    # -- datagrams

    def frame(self, body: bytes) -> bytes:
        """Return a serialised message as a datagram."""
        if not self.framed:
            return body
        return struct.pack("<I", len(body)) + body + struct.pack("<I", zlib.crc32(body))

    def unframe(self, datagram: bytes) -> bytes:
        """Return the serialised message in a datagram; check length and CRC where the version has them."""
        if not datagram:
            raise MessageError("empty", "empty datagram")
        if not self.framed:
            return datagram
        if len(datagram) < 8:
            raise MessageError("frame", f"{len(datagram)} bytes are too short for length and CRC")
        (length,) = struct.unpack_from("<I", datagram)
        if length != len(datagram) - 8:
            raise MessageError("frame", f"length {length} in a datagram of {len(datagram)} bytes")
        body = datagram[4:-4]
        if struct.unpack_from("<I", datagram, 4 + length)[0] != zlib.crc32(body):
            raise MessageError("CRC", "wrong CRC")
        return body

    def _parse(self, kind: Any, identifier: int, datagram: bytes) -> Any:
        """Return the message in a datagram; raise MessageError with the kind of fault."""
        try:
            message = kind.FromString(self.unframe(datagram))
        except DecodeError as error:
            raise MessageError("no message", "no message of this version") from error
        if not message.IsInitialized():
            missing = ", ".join(message.FindInitializationErrors())
            raise MessageError("missing field", f"missing: {missing}")
        if message.header.messageIdentifier != identifier:
            raise MessageError(
                "identifier", f"message identifier {message.header.messageIdentifier:#x}, not {identifier:#x}"
            )
        return message

    # -- monitoring

    def monitoring_message(self, monitoring: Monitoring) -> Any:
        """Return the message of a :class:`Monitoring`, not serialised."""
        message = self.monitoring_class()
        header = message.header
        header.messageIdentifier = MONITORING_IDENTIFIER
        header.sequenceCounter = monitoring.sequence
        header.reflectedSequenceCounter = monitoring.reflected
        robot = message.robotInfo
        robot.numberOfJoints = JOINTS
        robot.safetyState = monitoring.safety
        robot.driveState.extend([monitoring.drive] * JOINTS)
        robot.operationMode = monitoring.operation
        robot.controlMode = monitoring.control
        data = message.monitorData
        data.measuredJointPosition.value.extend(monitoring.position.tolist())
        data.measuredTorque.value.extend(monitoring.torque.tolist())
        data.commandedTorque.value.extend(monitoring.commanded_torque.tolist())
        data.externalTorque.value.extend(monitoring.external_torque.tolist())
        if self.cartesian:
            data.measuredCartesianPose.name = ""
            data.measuredCartesianPose.element.extend(monitoring.pose.tolist())
            data.measuredRedundancyInformation.strategy = 0  # E1
            data.measuredRedundancyInformation.value = monitoring.redundancy
        else:
            data.commandedJointPosition.value.extend(monitoring.commanded_position.tolist())
        if self.framed:
            data.externalForce.element.extend(monitoring.external_force.tolist())
        for io in monitoring.ios:
            _put_io(data.readIORequest.add(), io)
        data.timestamp.sec, data.timestamp.nanosec = divmod(monitoring.sent_at, 1_000_000_000)
        connection = message.connectionInfo
        connection.sessionState = monitoring.state
        connection.quality = monitoring.quality
        connection.sendPeriod = monitoring.send_period
        connection.receiveMultiplier = monitoring.receive_multiplier
        ipo = message.ipoData
        if monitoring.ipo is not None:
            ipo.jointPosition.value.extend(monitoring.ipo.tolist())
        ipo.clientCommandMode = monitoring.command_mode
        ipo.overlayType = monitoring.overlay
        ipo.trackingPerformance = monitoring.tracking
        return message

    def encode_monitoring(self, monitoring: Monitoring) -> bytes:
        """Return the datagram of a :class:`Monitoring`."""
        return self.frame(self.monitoring_message(monitoring).SerializeToString())

    def decode_monitoring(self, datagram: bytes) -> Any:
        """Decode the monitoring message in a datagram, as a protobuf message.

        Raises
        ------
        MessageError
            The datagram is no monitoring message.

        """
        return self._parse(self.monitoring_class, MONITORING_IDENTIFIER, datagram)

    # -- command

    def encode_command(self, command: Command) -> bytes:
        """Return the datagram of a :class:`Command`."""
        message = self.command_class()
        message.header.messageIdentifier = COMMAND_IDENTIFIER
        message.header.sequenceCounter = command.sequence
        message.header.reflectedSequenceCounter = command.reflected
        if command.position is not None:
            message.commandData.jointPosition.value.extend(np.asarray(command.position).tolist())
        if command.torque is not None:
            message.commandData.jointTorque.value.extend(np.asarray(command.torque).tolist())
        for io in command.ios:
            _put_io(message.commandData.writeIORequest.add(), io)
        return self.frame(message.SerializeToString())

    def decode_command(self, datagram: bytes) -> Command:
        """Decode the command in a datagram.

        Raises
        ------
        MessageError
            The datagram is no command, or does not have seven joint values.

        """
        message = self._parse(self.command_class, COMMAND_IDENTIFIER, datagram)
        data = message.commandData
        return Command(
            message.header.sequenceCounter,
            message.header.reflectedSequenceCounter,
            _joint_values(data, "jointPosition"),
            _joint_values(data, "jointTorque"),
            tuple(map(_get_io, data.writeIORequest)),
        )


def _joint_values(data: Any, name: str) -> NDArray[Any] | None:
    if not data.HasField(name):
        return None
    values = np.array(getattr(data, name).value, dtype=float)
    if values.shape != (JOINTS,):
        raise MessageError("number of joint values", f"{name} has {values.size} values, not {JOINTS}")
    return values


def _put_io(message: Any, io: IOValue) -> None:
    message.name, message.type, message.direction = io.name, io.type, io.direction
    if io.type is IOType.ANALOG:
        message.analogValue = io.value
    else:
        message.digitalValue = int(io.value)


def _get_io(message: Any) -> IOValue:
    try:
        kind, direction = IOType(message.type), IODirection(message.direction)
    except ValueError as error:
        raise MessageError("IO", f"IO '{message.name}': {error}") from error
    value = message.analogValue if kind is IOType.ANALOG else message.digitalValue
    return IOValue(message.name, kind, direction, value)
