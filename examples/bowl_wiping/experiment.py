# SPDX-License-Identifier: MIT
"""Define the bowl experiment: arm with the plate, bowl, trials and motion."""

from examples.bowl_wiping.analysis import LAWS
from examples.bowl_wiping.bowl import bowl_plant
from examples.bowl_wiping.tool import PLATE
from examples.bowl_wiping.trajectory import motion
from examples.experiments.command import Experiment
from examples.experiments.render import Camera

EXPERIMENT = Experiment(
    name="bowl_wiping",
    tool=PLATE,
    laws=LAWS,
    sample_times=(0.005,),
    motion=motion,
    plant=bowl_plant,
    camera=Camera((0.27, 0.2, 0.22), 1.65, 150.0, -24.0),
    pictured=(0.0, 0.26, 0.5, 0.63),
)
