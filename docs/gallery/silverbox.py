"""Silverbox, measured

Electricity. A measured record: an electronic oscillator whose spring hardens (Wigren and
Schoukens, 2013). Only its voltage is measured, 610 times a second, of which a filter
computes rates; a tenth of the record is used. The simulation is linear and its numbers
are not known. Cubic stiffness comes first. A tenth of the record does not settle which
dampings go with it, and two checks advise caution. Put the file in the folder that
`BAYES_GREYBOX_DATA` names.
"""

import bayes_greybox as bg

parts = bg.load_dataset("silverbox", remove_offset=True)
train, test = (
    parts[part]
    .split(0.1)[0]
    .differentiate(rates={"y": "v"}, method="bandlimited", band=200.0)
    for part in ("multisine_train", "multisine_test")
)
model = bg.GreyBox(
    simulation={"y": "v"},
    dictionary={"v": ["y", "v", "u", "1"]},
    discrepancy=bg.OrthogonalGP(variables=("y", "v")),
)
study = bg.find_missing_effects(
    model, train, test=test, catalogue="mechanical", settle=False
)
