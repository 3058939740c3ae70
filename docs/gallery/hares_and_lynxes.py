"""Hares and lynxes, measured

Populations. A measured record: the pelts of Hudson Bay, hares and lynxes once a year for
21 years (Odum, 1953). In the simulation lynxes live on hares, and no hare is lost to
them. Twenty-one years do not tell two laws of hunting apart, and what is left has a law
without a name, under which a few free runs go astray. The file comes from posteriordb, a
public collection of data; put it in the folder that `BAYES_GREYBOX_DATA` names.
"""

import bayes_greybox as bg

measured = bg.load_dataset("hudson_bay")
model = bg.GreyBox(
    simulation={"hare": "0.55*hare", "lynx": "0.024*hare*lynx - 0.8*lynx"},
    dictionary={"hare": []},
    rows=bg.TrajectoryRows(),
)
study = bg.find_missing_effects(model, measured, catalogue="population", settle=False)
