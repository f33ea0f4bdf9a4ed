from . import lines as lines, se2 as se2, twistors as twistors
