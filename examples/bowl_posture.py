# SPDX-License-Identifier: MIT
"""Compute torque and tangent of a spring at the tip of the iiwa 14, on the paper's bowl-wiping trajectory.

``make generate`` runs this example. First it computes a spring from its energy alone: the torque -dU/dq, and the
joint stiffness d2U/dq2, its exact tangent. Then it evaluates the paper's formula, corrected and conventional, for a
chosen wrench and task stiffness. The stiffnesses are the paper's (hybrid frame); the wrench has the size that the
paper reports.
"""

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from generated import iiwa14  # noqa: E402

TRAJECTORY = ROOT / "examples" / "bowl_wiping" / "zero_force_trajectory.csv"
TASK_STIFFNESS = np.diag([700.0, 700.0, 800.0, 30.0, 30.0, 30.0])  # N/m and N m/rad
WRENCH = np.array([5.0, -10.0, 15.0, 4.0, -3.0, 8.0])  # N and N m, applied by the environment to the robot


def main() -> None:
    """Print energy, torque and stiffness of a spring, and both joint stiffnesses, halfway through the bowl's wiping."""
    trajectory = np.loadtxt(TRAJECTORY, delimiter=",")
    sample = trajectory.shape[1] // 2
    q = trajectory[:, sample]
    equilibrium = iiwa14.forward_kinematics(trajectory[:, sample - 100])  # half a second behind
    energy, torque, tangent = iiwa14.spring.linearization(
        q, equilibrium, TASK_STIFFNESS[:3, :3], TASK_STIFFNESS[3:, 3:]
    )
    corrected = iiwa14.hybrid.joint_stiffness(q, WRENCH, TASK_STIFFNESS)
    conventional = iiwa14.hybrid.joint_stiffness_uncorrected(q, WRENCH, TASK_STIFFNESS)
    with np.printoptions(precision=2, suppress=True, linewidth=100):
        print(f"iiwa14, bowl-wiping sample {sample}, q [rad] = {q}")
        print(f"\nspring to the pose 0.5 s before: energy {energy:.4f} J, torque [N m] = {torque}")
        print(f"joint stiffness of the spring, -d torque/dq [N m/rad]:\n{tangent}")
        print(f"\nwrench applied by the environment [N, N m] = {WRENCH}")
        for title, stiffness in (("corrected", corrected), ("conventional", conventional)):
            antisymmetric = (stiffness - stiffness.T) / 2
            print(f"\njoint stiffness, {title} [N m/rad]:\n{stiffness}")
            print(f"largest singular value of its antisymmetric part: {np.linalg.norm(antisymmetric, 2):.4f} N m/rad")


if __name__ == "__main__":
    main()
