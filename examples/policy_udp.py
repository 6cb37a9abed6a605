# SPDX-License-Identifier: MIT
"""Drive the controller by a policy that sends proposals over UDP at 20 Hz, falls silent, and comes back.

    python -m examples.policy_udp             prints what the port does in each half second

The policy is a thread that sends datagrams to this computer; one in four is lost, one in ten has a NaN. The arm is
simulated with the folder's mass matrix. Time stamps are time.monotonic() of the sender. Between two computers,
synchronise the clocks (PTP, NTP), and send a time that both share. UDP has no
authentication: use a network of your own.
"""

from __future__ import annotations

import argparse
import socket
import struct
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

PACKET = struct.Struct("<4sd16d36d6dd")
"""Little-endian: magic, time stamp [s], pose (4, 4), stiffness (6, 6), wrench_command (6), gripper."""
MAGIC = b"SGP1"
Q0 = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])  # rad
STIFFNESS = np.diag([500.0, 500.0, 500.0, 30.0, 30.0, 30.0])  # N/m, N m/rad
MOTOR = 0.1 * np.eye(7)  # kg m^2 of the rotors
HEAVIEST = (40.0, 10.0)  # N, N m: what the springs may exert where the tip is stopped
T, PERIOD = 0.001, 0.05  # s
SILENT = (1.0, 2.2)  # s: the policy sends nothing


def pack(stamp: float, pose: np.ndarray, wrench: np.ndarray, gripper: float) -> bytes:
    """Return a datagram."""
    return PACKET.pack(MAGIC, stamp, *pose.ravel(), *STIFFNESS.ravel(), *wrench, gripper)


def unpack(data: bytes) -> dict[str, Any] | None:
    """Return the arguments of Policy.propose, or None for a datagram that is no proposal.

    Springs of the controller do not couple translation and rotation: the blocks of the matrix that do are not read.
    """
    if len(data) != PACKET.size or not data.startswith(MAGIC):
        return None
    numbers = np.array(PACKET.unpack(data)[1:])
    return {
        "time": numbers[0],
        "pose": numbers[1:17].reshape(4, 4),
        "translation_stiffness": numbers[17:53].reshape(6, 6)[:3, :3],
        "rotation_stiffness": numbers[17:53].reshape(6, 6)[3:, 3:],
        "wrench_command": numbers[53:59],
        "gripper": float(numbers[59]),
    }


def send(address: tuple[str, int], first: np.ndarray, begin: float, seconds: float) -> None:
    """Send proposals: the tip moves on a circle; the wrench presses down with 2 N."""
    random = np.random.default_rng(1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        while (now := time.monotonic()) < begin + seconds:
            pose, angle = first.copy(), 2 * np.pi * 0.4 * (now - begin)
            pose[:3, 3] += 0.05 * np.array([0.0, np.sin(angle), 1 - np.cos(angle)])
            if random.random() < 0.1:
                pose[0, 3] = np.nan
            lost = random.random() < 0.25 or SILENT[0] < now - begin < SILENT[1]
            if not lost:
                out.sendto(pack(now, pose, np.array([0.0, 0, -2, 0, 0, 0]), np.sin(angle)), address)
            time.sleep(PERIOD)


def receive(incoming: socket.socket, port: Any, begin: float) -> list[str]:
    """Hand all waiting datagrams to the port; return what was refused."""
    refused: list[str] = []
    while True:
        try:
            data = incoming.recv(2048)
        except BlockingIOError:
            return refused
        proposal = unpack(data)
        if proposal is None:
            refused.append("datagram")
            continue
        proposal["time"] -= begin
        refused += [
            f"{part}: {why.name}" for part, why in port.propose(now=time.monotonic() - begin, **proposal).items()
        ]


def simulate(robot: Any, seconds: float) -> list[dict[str, Any]]:
    """Run port, follower, controller and arm in real time; return a row for each half second."""
    controller = robot.Impedance(sample_time=T, delay_samples=0, motor_inertia=np.diag(MOTOR), heaviest_wrench=HEAVIEST)
    follow = robot.Follow(Q0, sample_time=T)
    q, dq, rows = Q0.copy(), np.zeros(7), []
    first, begin, refused = robot.forward_kinematics(Q0), time.monotonic(), []
    port = robot.Policy(pose=first, now=0.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as incoming:
        incoming.bind(("127.0.0.1", 0))
        incoming.setblocking(False)
        sender = threading.Thread(target=send, args=(incoming.getsockname(), first, begin, seconds))
        sender.start()
        for k in range(1, round(seconds / T) + 1):
            time.sleep(max(begin + k * T - time.monotonic(), 0.0))
            refused += receive(incoming, port, begin)
            command = port.command(time.monotonic() - begin)
            out = controller.step(
                q=q, dq=dq, q0=follow.step(pose=command.pose).q0, shaped=True, counter=k,
                translation_stiffness=command.translation_stiffness, rotation_stiffness=command.rotation_stiffness,
                wrench_command=command.wrench_command,
            )  # fmt: skip
            dq = dq + T * np.linalg.solve(robot.mass_matrix(q) + MOTOR, out.torque)
            q = q + T * dq
            if k % 500 == 0:
                stiffness = float(command.translation_stiffness[0, 0])
                error = 1e3 * float(np.linalg.norm((command.pose - robot.forward_kinematics(q))[:3, 3]))
                rows.append({"time": k * T, "stage": port.stage["pose"].name, "stiffness": stiffness, "error": error,
                             "gripper": command.gripper, "fault": out.fault.name, "refused": refused})  # fmt: skip
                refused = []
        sender.join()
    return rows


def main() -> int:
    """Run the example; options stand in the text of this module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=3.0, help="duration [s] [3]")
    options = parser.parse_args()
    from generated import iiwa14

    print(" time  stage     stiffness  error  gripper  fault  refused")
    for row in simulate(iiwa14, options.seconds):
        print(f"{row['time']:4.1f} s  {row['stage']:8} {row['stiffness']:6.0f} N/m {row['error']:3.0f} mm  "
              f"{row['gripper']:6.2f}  {row['fault']:5}  {', '.join(sorted(set(row['refused'])))}")  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
