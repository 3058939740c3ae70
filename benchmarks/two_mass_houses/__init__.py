"""Houses with one thermometer: is the second thermal mass found?"""
