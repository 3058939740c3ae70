"""Hares and lynxes, measured

Populations. A measured record: the pelts of Hudson Bay, one number a year for 21 years
(Odum, 1953). In the simulation lynxes live on hares, and no hare is lost to them. Twenty-
one numbers do not tell two laws of hunting apart. The file is that of posteriordb;
`BAYES_GREYBOX_DATA` says where it lies.
"""

import bayes_greybox as bg

measured = bg.load_dataset("hudson_bay")
model = bg.GreyBox(
    simulation={"hare": "0.55*hare", "lynx": "0.024*hare*lynx - 0.8*lynx"},
    dictionary={"hare": []},
    rows=bg.TrajectoryRows(),
)
study = bg.find_missing_effects(model, measured, catalogue="population", settle=False)
