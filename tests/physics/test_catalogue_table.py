"""The catalogue as users list and search it."""

import pytest

import bayes_greybox as bg
from bayes_greybox.physics.catalogue.loading import load_catalogue


def test_every_effect_has_a_row():
    table = bg.catalogue()
    assert list(table["slug"]) == [effect.slug for effect in load_catalogue("all")]
    assert set(bg.catalogue("mechanical")["domain"]) == {"mechanical"}
    row = table.set_index("slug").loc["dead-zone"]
    assert row["roles"] == ("position",) and len(row["inner"]) == 1 and row["meaning"] and "max" in row["expression"]
    assert row["sign"] == -1 and "from rest" in row["reverse"]
    assert set(table["sign"]) == {-1, 0, 1}


def test_effects_are_found_by_words_of_any_column_and_case():
    slugs = set(bg.catalogue("mechanical", search="FRICTION")["slug"])
    assert {"coulomb-friction", "stribeck-friction"} <= slugs < set(bg.catalogue("mechanical")["slug"])
    assert list(bg.catalogue(search="coulomb friction").columns) == list(bg.catalogue().columns)


def test_what_finds_nothing_is_said():
    with pytest.raises(bg.InputError, match="No effect of the catalogue has 'unobtainium' in it"):
        bg.catalogue(search="unobtainium")
    with pytest.raises(bg.InputError, match="There is no catalogue 'mechanicl'"):
        bg.catalogue("mechanicl")
