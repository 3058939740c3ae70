import pytest

import bayes_greybox as bg
from bayes_greybox.physics.catalogue.names import PERSONS, listing, within


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Cubic stiffness", "cubic stiffness"),
        ("Coulomb friction", "Coulomb friction"),
        ("Van der Pol damping", "Van der Pol damping"),
        ("Bouc-Wen hysteresis", "Bouc-Wen hysteresis"),
        ("LuGre friction", "LuGre friction"),
        ("DC offset", "DC offset"),
        ("Direction-dependent friction", "direction-dependent friction"),
        ("Cubic stiffness + Quadratic drag", "cubic stiffness + quadratic drag"),
        ("Ölfilm", "ölfilm"),
        ("", ""),
    ],
)
def test_a_name_within_a_sentence_keeps_the_capitals_of_people_and_short_forms(name, said):
    assert within(name) == said


def test_a_list_of_names_begins_with_a_capital_and_has_no_other():
    assert listing(["Cubic stiffness", "Quadratic drag"]) == "Cubic stiffness + quadratic drag"
    assert listing(["Cubic stiffness", "Coulomb friction", "Dead zone"], ", ") == (
        "Cubic stiffness, Coulomb friction, dead zone"
    )
    assert listing([], ", ") == ""


def test_whose_names_the_catalogue_has_keep_their_capital():
    kept = {name.replace("-", " ").split()[0] for name in bg.catalogue()["name"] if within(name)[0].isupper()}
    assert kept - PERSONS == {"LuGre"}
    assert {"Allee", "Coulomb", "Dahl", "Holling", "Maxwell", "Stribeck", "Torricelli", "Van", "Bouc"} <= kept
