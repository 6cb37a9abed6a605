# SPDX-License-Identifier: MIT
"""Record an episode, or replay one and compare it with the recording. Nothing is fetched from a hub.

    python -m lerobot_robot_stiffgen.episode record FOLDER --robot FILE   needs lerobot[dataset]
    python -m lerobot_robot_stiffgen.episode replay FOLDER --robot FILE   prints the largest differences

FOLDER is a LeRobotDataset (version 3) with one episode. lerobot-replay replays it, too (docs/policies.md).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet
from lerobot.robots.robot import Robot

from .arm import Stiffgen
from .config import StiffgenConfig
from .simulation import Array

RATE, DURATION = 20, 6.0
"""Actions per second [Hz] and duration [s] of the recorded episode."""


@dataclass(frozen=True)
class Episode:
    """Actions and states of an episode, one row per frame, and the names of their columns."""

    action_names: list[str]
    actions: Array
    state_names: list[str]
    states: Array

    def action(self, frame: int) -> dict[str, float]:
        """Return the action of a frame by name."""
        return dict(zip(self.action_names, self.actions[frame].tolist(), strict=True))


def read(folder: Path) -> Episode:
    """Return the first episode of a LeRobotDataset."""
    features = json.loads((folder / "meta" / "info.json").read_text())["features"]
    table = parquet.ParquetFile(folder / "data" / "chunk-000" / "file-000.parquet").read()
    rows = np.array(table["episode_index"]) == 0
    keys = ("action", "observation.state")
    columns = [np.array(table[key].to_pylist())[rows] for key in keys]
    names = [list(features[key]["names"]) for key in keys]
    return Episode(names[0], columns[0], names[1], columns[1])


def motion(first: Mapping[str, float], time: float) -> dict[str, float]:
    """Return the action at a time [s]: circle of 10 cm, small turns, and a stiffness that falls and rises."""
    angle = 2 * np.pi * time / 3.0
    change = {"ee.y": 0.05 * np.sin(angle), "ee.z": 0.05 * (1 - np.cos(angle)), "ee.wx": 0.2 * np.sin(angle)}
    action = {name: first[name] + change.get(name, 0.0) for name in first if name.startswith("ee.")}
    share = 0.6 + 0.4 * np.cos(angle)
    return action | {"stiffness.translation": 800.0 * share, "stiffness.rotation": 40.0 * share}


def record(robot: Stiffgen, folder: Path) -> None:
    """Record an episode of :func:`motion` as a LeRobotDataset. The folder must not exist."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    kinds = {"action": list(robot.action_features), "observation.state": list(robot.observation_features)}
    features = {key: {"dtype": "float32", "shape": (len(names),), "names": names} for key, names in kinds.items()}
    dataset = LeRobotDataset.create("stiffgen/circle", RATE, features, folder, robot.name, use_videos=False)
    with robot:
        first = robot.get_observation()
        for frame in range(round(DURATION * RATE)):
            wanted = motion(first, frame / RATE)
            action = np.array([wanted[name] for name in kinds["action"]], np.float32)  # a replay reads these bits
            state = np.array(list(robot.get_observation().values()), np.float32)
            robot.send_action(dict(zip(kinds["action"], action.tolist(), strict=True)))
            dataset.add_frame({"action": action, "observation.state": state, "task": "Follow a circle."})
    dataset.save_episode()
    dataset.finalize()


def replay(robot: Robot, episode: Episode) -> Array:
    """Send the actions of an episode to a connected robot; return its states before each action, one row per frame."""
    states = []
    for frame in range(len(episode.actions)):
        observation = robot.get_observation()
        states.append([observation[name] for name in episode.state_names])
        robot.send_action(episode.action(frame))
    return np.array(states)


def main() -> int:
    """Record or replay; options stand in the text of this module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("task", choices=("record", "replay"), help="what to do")
    parser.add_argument("folder", type=Path, help="folder of the LeRobotDataset")
    parser.add_argument("--robot", type=Path, required=True, help="robot's file, or folder of stiffgen generate")
    parser.add_argument("--model", type=Path, help="file that MuJoCo simulates [the robot's file]")
    options = parser.parse_args()
    robot = Stiffgen(
        StiffgenConfig(
            robot=options.robot,
            model=options.model,
            variable_stiffness=True,
            motor_inertia=0.1,
            command_rate=RATE,
            real_time=False,
        )
    )
    if options.task == "record":
        record(robot, options.folder)
        return 0
    episode = read(options.folder)
    with robot:
        difference = np.abs(replay(robot, episode) - episode.states).max(axis=0)
    for end, unit in ((".pos", "rad"), (".vel", "rad/s"), ("ee.", "m, rad")):
        part = [d for name, d in zip(episode.state_names, difference, strict=True) if end in name]
        print(f"{end:4} at most {max(part):.1e} {unit} from the recording")
    return 0


if __name__ == "__main__":
    sys.exit(main())
