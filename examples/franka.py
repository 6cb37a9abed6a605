# SPDX-License-Identifier: MIT
"""Run the generated controller on a Franka FR3, through libfranka's own Python package.

python -m examples.franka                    on franky-sim, a simulated FR3 that speaks the robot's protocol
python -m examples.franka --robot ADDRESS    on a robot: read docs/controller.md first

Needs ``pip install -e '.[franka]'``. The tip follows a circle on a spring; what is missed or refused is counted.
"""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen import generate

FOLDER = Path("build") / "robots"
SAMPLE_TIME = 0.001  # s
RADIUS, LAP = 0.05, 8.0  # m, s
ROTORS = [0.2, 0.2, 0.2, 0.2, 0.07, 0.07, 0.07]  # kg m^2, of the motors at the joints: a guess
TRANSLATION, ROTATION = 400.0, 25.0  # N/m, N m/rad
HEAVIEST = (40.0, 10.0)  # N, N m: what the tip may press on the way


def fr3() -> Any:
    """Return the FR3's module, generated from the description that franky-sim brings.

    libfranka adds <position_based_velocity_limits> to joints, which no URDF has: it is left out.
    """
    folder = FOLDER / "fr3"
    if not (folder / "manifest.json").exists():
        robot = ET.fromstring(import_module("franky_sim").FR3_URDF)
        for joint in robot.iter("joint"):
            for element in joint.findall("position_based_velocity_limits"):
                joint.remove(element)
        FOLDER.mkdir(parents=True, exist_ok=True)
        urdf = FOLDER / "fr3.urdf"
        urdf.write_bytes(ET.tostring(robot))
        generate(urdf, tip="link8", name="fr3", output=FOLDER)
    sys.path.insert(0, str(FOLDER))
    return import_module("fr3")


@contextmanager
def simulator(address: str) -> Iterator[None]:
    """Run franky-sim's server in a process of its own."""
    code = "from franky_sim.run_server import main; main()"
    command = [sys.executable, "-c", code, "-s", "mujoco", "--hostname", address]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        time.sleep(5.0)  # the server gives no sign that it is ready
        yield
    finally:
        process.terminate()
        process.wait()


def connected(address: str, patience: float = 30.0) -> Any:
    """Wait for the robot and return it."""
    franka = import_module("pylibfranka")
    end = time.monotonic() + patience
    while True:
        try:
            return franka.Robot(address, franka.RealtimeConfig.kIgnore)
        except franka.FrankaException:
            if time.monotonic() > end:
                raise
            time.sleep(0.5)


def wipe(robot: Any, module: Any, seconds: float) -> dict[str, float]:
    """Follow the circle for `seconds`; return the counts. Print the first fault when it comes."""
    franka = import_module("pylibfranka")
    start = np.array(robot.read_once().q)
    rest = module.forward_kinematics(start)
    follow = module.Follow(start, sample_time=SAMPLE_TIME)
    controller = module.Impedance(
        sample_time=SAMPLE_TIME, delay_samples=1, motor_inertia=ROTORS, heaviest_wrench=HEAVIEST,
        torque_rate_limit=np.minimum(10.0 * module.EFFORT, 900.0),
    )  # fmt: skip
    Kt, Ko = TRANSLATION * np.eye(3), ROTATION * np.eye(3)  # [N/m], [N m/rad]
    counted = {"cycles": 0, "missed": 0, "faults": 0, "error": 0.0, "step": 0.0}
    control, counter, elapsed = robot.start_torque_control(), 0, 0.0
    while elapsed < seconds:
        state, duration = control.readOnce()
        periods = round(duration.to_sec() / SAMPLE_TIME)
        counted["missed"] += max(periods - 1, 0)  # cycles of the robot that this program missed
        counter += max(periods, 1)
        elapsed = counter * SAMPLE_TIME
        begin = time.perf_counter()
        q, wanted = np.array(state.q), _on_circle(rest, elapsed)
        for _ in range(max(periods, 1)):  # its speed is per sample time, also of those that were missed
            q0 = follow.step(pose=wanted).q0
        output = controller.step(
            q=q, dq=np.array(state.dq), q0=q0, shaped=True, counter=counter, translation_stiffness=Kt,
            rotation_stiffness=Ko,
        )  # fmt: skip
        control.writeOnce(franka.Torques(output.torque.tolist()))
        pose = module.forward_kinematics(q)
        counted["cycles"] += 1
        if output.fault and not counted["faults"]:
            print(f"after {elapsed:.1f} s: {module.Fault(output.fault).name}, {module.Reason(output.reason).name}")
        counted["faults"] += output.fault != 0
        counted["step"] = max(counted["step"], time.perf_counter() - begin)
        if elapsed > 2.0:  # [s] from the start on which the arm follows
            counted["error"] = max(counted["error"], float(np.linalg.norm(pose[:3, 3] - wanted[:3, 3])))
    end = franka.Torques([0.0] * 7)
    end.motion_finished = True
    control.writeOnce(end)
    return counted


def _on_circle(rest: Any, elapsed: float) -> Any:
    """Return the pose on the circle in the y-z plane that begins at ``rest``, after a time [s]."""
    phase = 2 * math.pi * elapsed / LAP
    wanted = rest.copy()
    wanted[:3, 3] += RADIUS * np.array([0.0, math.sin(phase), 1.0 - math.cos(phase)])
    return wanted


def main(arguments: list[str] | None = None) -> int:
    """Run the example; return 1 if a cycle was missed or the controller released the arm."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", metavar="ADDRESS", help="of a robot (default: franky-sim on this machine)")
    parser.add_argument("--seconds", type=float, default=600.0)
    options = parser.parse_args(arguments)
    module = fr3()
    if options.robot:
        counted = wipe(connected(options.robot), module, options.seconds)
    else:
        with simulator("127.0.0.1"):
            counted = wipe(connected("127.0.0.1"), module, options.seconds)
    print(
        f"{counted['cycles']:.0f} cycles, {counted['missed']:.0f} missed, {counted['faults']:.0f} with a fault; "
        f"largest distance from the commanded pose {1e3 * counted['error']:.1f} mm, "
        f"longest step in Python {1e3 * counted['step']:.2f} ms"
    )
    return int(counted["missed"] > 0 or counted["faults"] > 0)


if __name__ == "__main__":
    sys.exit(main())
