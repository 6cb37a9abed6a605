# SPDX-License-Identifier: MIT
"""Define the parkour experiment: arm with the ball, board, trials and motion."""

from examples.experiments.command import Experiment
from examples.experiments.render import Camera
from examples.experiments.trial import LAWS
from examples.parkour.board import parkour_plant
from examples.parkour.tool import BALL
from examples.parkour.trajectory import motion

EXPERIMENT = Experiment(
    name="parkour",
    tool=BALL,
    laws=LAWS,
    sample_times=(0.005, 0.001),
    motion=motion,
    plant=parkour_plant,
    camera=Camera((0.42, 0.03, 0.12), 1.45, 200.0, -22.0),
    pictured=(0.0, 0.31, 0.58, 0.84),
)
