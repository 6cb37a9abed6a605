# SPDX-License-Identifier: MIT
"""Oracles of the sensor."""

from __future__ import annotations

from functools import partial

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.core.verify.kernels.poses import joint_poses
from stiffgen.core.verify.kernels.references import References, as_columns
from stiffgen.families.sensor.reference import expressions


def sensor(r: References) -> dict[str, FloatArray]:
    """Return wrenches and readings of a force-torque sensor, by the kernel's name."""
    (tip,) = r.chain.tips
    joint_pose = joint_poses(r.chain, r.place.q, r.place.base())[tip.joint]
    results = {}
    for name, (value, symbols, arguments) in expressions(r.chain, r.place, joint_pose, tip=r.pose_expression).items():
        columns = [as_columns(each) for each in r.samples.of(arguments)]
        results[name] = r.evaluate(value, symbols, columns)[..., 0]
    return results


def _of_sensor(r: References, name: str) -> FloatArray:
    return r.of(sensor)[name]


ORACLES = {
    **{
        f"sensor_{name}": (Oracle("momenta of the payload", partial(_of_sensor, name=name)),)
        for name in ("tip_wrench", "reading", "tip_wrench_dynamic")
    },
    "sensor_joint_stiffness": (
        Oracle(
            "formula on the wrench of a reading",
            lambda r: r.joint_stiffness("hybrid", corrected=True, wrench=r.of(sensor)["tip_wrench"]),
        ),
    ),
}
