# SPDX-License-Identifier: MIT
"""Wrench of the environment at the tip from a force-torque sensor's reading, the reading, and the joint stiffness."""

from __future__ import annotations

import math
from functools import partial

from stiffgen.core.names import comment
from stiffgen.core.robot.chain import Chain, MountedSensor
from stiffgen.core.symbolic import arguments, quantities
from stiffgen.core.symbolic.arguments import POSE, TOOL_POSE, VELOCITY, Argument, configuration_arguments
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.pieces import columns_and_pose, over_joints, tangent, tip_pose
from stiffgen.core.symbolic.program import Array, Program
from stiffgen.core.symbolic.quantities import BlockKind, Blocks, Normal
from stiffgen.core.symbolic.steps import StraightLine
from stiffgen.families.sensor import expressions as wrenches

GROUP = "sensor"

_LOADS = Normal((30.0, 30.0, 30.0, 10.0, 10.0, 10.0))
READING = Argument(
    "reading", (6,), "N, N m", "(force, moment) that the sensor reports, in sensor axes about its origin",
    symbol="r", draw=_LOADS, blocks=quantities.WRENCH,
)  # fmt: skip
BIAS = Argument(
    "bias", (6,), "N, N m", "reading without payload and contact, in sensor axes; 'stiffgen calibrate' estimates it",
    symbol="b", draw=_LOADS, blocks=quantities.WRENCH,
)  # fmt: skip
_MASS = BlockKind("mass", "kg", 20.0)
_MOMENT = BlockKind("first moment", "kg m", 5.0)
_TENSOR = BlockKind("inertia", "kg m^2", 2.0)
_BEHIND = "of all that hangs behind the sensor, in sensor axes from the sensor's origin"
PAYLOAD = Argument(
    "payload", (4,), "kg, kg m", f"mass and first moment (mass times centre of mass) {_BEHIND}",
    symbol="l", draw=Normal((2.0, 0.2, 0.2, 0.2)), blocks=Blocks((_MASS, _MOMENT), lambda row: int(row > 0)),
)  # fmt: skip
MOVING_PAYLOAD = Argument(
    "payload", (10,), "kg, kg m, kg m^2",
    f"mass, first moment (3) and inertia about the sensor's origin (xx, xy, xz, yy, yz, zz) {_BEHIND}",
    symbol="l", draw=Normal((2.0, *3 * (0.2,), *6 * (0.05,))),
    blocks=Blocks((_MASS, _MOMENT, _TENSOR), lambda row: int(row > 0) + int(row > 3)),
)  # fmt: skip
ACCELERATION = Argument(
    "acceleration", ("n",), "rad/s^2 or m/s^2", "second derivatives of the joint positions", symbol="ddq",
    draw=Normal(5.0), largest=50.0,
    floating_meaning="rate of the base link's twist as seen from the base, then second derivatives of the joints",
)  # fmt: skip
WRENCH = arguments.wrench("hybrid")


def _arrays(chain: Chain, *further: Argument) -> tuple[Array, ...]:
    tool = (TOOL_POSE,) if chain.runtime_tool else ()
    return tuple(argument.array(chain) for argument in (POSE, *tool, *further))


def tip_wrench(chain: Chain, result: Argument) -> Program:
    """Return the program of the tip's pose and of the wrench there."""
    inputs = _arrays(chain, READING, BIAS, PAYLOAD)
    heading = "wrench at the tip, base axes"
    wrench = StraightLine((result.array(chain),), wrenches.tip_wrench, inputs, heading=heading)
    return tip_pose(chain, inputs[0]), wrench


def reading(chain: Chain, result: Argument) -> Program:
    """Return the program of the tip's pose and of the sensor's reading."""
    inputs = _arrays(chain, WRENCH, BIAS, PAYLOAD)
    heading = "reading of the sensor, sensor axes"
    return tip_pose(chain, inputs[0]), StraightLine((result.array(chain),), wrenches.reading, inputs, heading=heading)


def tip_wrench_dynamic(chain: Chain, result: Argument) -> Program:
    """Return the program of the wrench at the tip of a moving robot."""
    inputs = (
        *configuration_arguments(runtime_tool=chain.runtime_tool, floating=chain.floating),
        VELOCITY, ACCELERATION, READING, BIAS, MOVING_PAYLOAD,
    )  # fmt: skip
    arrays = tuple(argument.array(chain) for argument in inputs)
    heading = "wrench at the tip, base axes"
    return (StraightLine((result.array(chain),), wrenches.tip_wrench_dynamic, arrays, heading=heading),)


def joint_stiffness(chain: Chain, result: Argument, task_stiffness: Argument) -> Program:
    """Return the program of the joint stiffness under the wrench of a reading; one pass over the joints."""

    def steps(output: Array) -> Program:
        pose, *given = _arrays(chain, READING, BIAS, PAYLOAD)
        J, F = Array("J", (6, len(chain.joints))), WRENCH.array(chain)
        heading = "wrench F at the tip, base axes"
        wrench = StraightLine((F,), wrenches.tip_wrench, (pose, *given), heading=heading, is_linear=True)
        stiffness = tangent(chain, J, F, task_stiffness.array(chain), "hybrid", output)
        return columns_and_pose(chain, J, pose), wrench, *stiffness

    return over_joints(chain, result, steps, mirror=True)


def _note(sensor: MountedSensor, reference: str) -> str:
    """Return where the sensor sits, whose wrench it reports, and the gravity."""
    far = math.sqrt(sum(x * x for x in sensor.translation))
    where = "at the tip's origin" if far == 0 else f"{far:.4g} m from the tip's origin"
    gravity = ", ".join(f"{each:.6g}" for each in sensor.option.gravity)
    acts = (
        "tool and environment apply to the robot"
        if sensor.option.sign == "environment"
        else "the robot applies to the tool"
    )
    return (
        f"The sensor is on link {comment(sensor.option.link)}, {where} at generation, and reports the wrench that "
        f"{acts} (--sensor sign={sensor.option.sign}). Free fall is ({gravity}) m/s^2 in {reference} axes."
    )


def sensor_kernels(configuration: tuple[Argument, ...], sensor: MountedSensor, reference: str) -> tuple[Kernel, ...]:
    """Return the kernels of a force-torque sensor; ``reference`` names the frame of the wrench's axes."""
    wrench = Argument.referred(
        "tip_wrench", (6,), "N, N m",
        "(force, moment) that the environment applies to the robot, in {reference} axes, moment about the tip's origin",
        blocks=quantities.WRENCH,
    )  # fmt: skip
    reported = Argument("sensor_reading", (6,), READING.unit, READING.meaning, blocks=quantities.WRENCH)
    stiffness = Argument("joint_stiffness", ("n", "n"), "N m/rad", "bitwise symmetric", symmetric=True)
    upper, note = arguments.task_stiffness("hybrid", symmetric_part=True), _note(sensor, reference)
    sign = "" if sensor.option.sign == "environment" else "-"
    net = f"w = {sign}(reading - bias)"
    kernel = partial(Kernel, group=GROUP, note=note, batch=True)
    return (
        kernel(
            name="tip_wrench",
            arguments=(*configuration, READING, BIAS, PAYLOAD),
            results=(wrench,),
            summary="Wrench of the environment at the tip, from the reading of a robot at rest.",
            equation=f"F = X^T ({net} - weight of the payload), X^T from the sensor to the tip",
            program=partial(tip_wrench, result=wrench),
        ),
        kernel(
            name="reading",
            arguments=(*configuration, WRENCH, BIAS, PAYLOAD),
            results=(reported,),
            summary="Reading of the sensor of a robot at rest, for simulations; the inverse of tip_wrench.",
            equation=f"reading of {net} = X^-T F + weight of the payload",
            program=partial(reading, result=reported),
        ),
        kernel(
            name="tip_wrench_dynamic",
            arguments=(*configuration, VELOCITY, ACCELERATION, READING, BIAS, MOVING_PAYLOAD),
            results=(wrench,),
            summary="Wrench of the environment at the tip, from the reading of a robot in motion.",
            equation=f"F = X^T ({net} - weight + rate of the payload's momentum), Newton and Euler",
            program=partial(tip_wrench_dynamic, result=wrench),
        ),
        kernel(
            name="joint_stiffness",
            arguments=(*configuration, READING, BIAS, PAYLOAD, upper),
            results=(stiffness,),
            summary="Symmetric joint stiffness under the wrench of a reading, in one pass over the joints.",
            equation="Kq of hybrid.joint_stiffness at F = tip_wrench(q, reading, bias, payload)",
            program=partial(joint_stiffness, result=stiffness, task_stiffness=upper),
        ),
    )
