"""Where the 68 iBUG landmarks [Sagonas2016] are on MakeHuman's base mesh hm08 [MakeHuman2020].

The project's own face detector found them on pictures of the mean head; they were checked and
corrected on pictures of the mesh. Left and right ones are mirror images: hm08 is symmetric.
"""

from __future__ import annotations

LANDMARKS = (
    5763, 5097, 866, 912, 740, 742, 891, 918,  # from the right ear along the jaw
    5296,  # chin
    7620, 7593, 7462, 7460, 7614, 7571, 11712, 12360,  # along the jaw to the left ear
    212, 207, 176, 180, 209,  # right brow, from outside
    6984, 6956, 6952, 6982, 6987,  # left brow, from the middle
    132, 135, 164, 294,  # ridge of the nose
    326, 313, 343, 7076, 7088,  # under the nose
    21, 0, 54, 70, 47, 41,  # right eye, from its outer corner over the upper lid
    6854, 6838, 6784, 6805, 6825, 6831,  # left eye, from its inner corner over the upper lid
    402, 410, 450, 455, 7210, 7170, 7162,  # upper lip's outer edge, from the right corner
    7166, 7241, 492, 486, 406,  # lower lip's outer edge, from the left
    501, 471, 474, 7227, 7250,  # where the upper lip meets the lower one, from the right
    7242, 493, 487,  # where the lower lip meets the upper one, from the left
)  # fmt: skip
"""(68,) vertices of base.obj, numbered from 0, in iBUG's order."""
