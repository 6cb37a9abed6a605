"""A robot that speaks FRI: KUKA's controller side of the Fast Robot Interface, with a simulated LBR iiwa 14 behind it."""
