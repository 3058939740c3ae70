"""Nothing is written outside the folder that was asked for, whatever results are called and whatever lies there."""

import pytest
from damaging import small
from matplotlib.figure import Figure

import bayes_greybox as bg
from bayes_greybox.config import load_config
from bayes_greybox.report.folders.writing import staged
from bayes_greybox.report.plots.style import save_figures

OUTSIDE = ("../x", "../../x", "/tmp/x", "a/b", "..\\x", ".", "..", "a\0b", "")


@pytest.mark.parametrize("name", OUTSIDE)
def test_figures_of_such_names_are_refused(name, tmp_path):
    with pytest.raises(bg.InputError, match="cannot name a figure's file"):
        save_figures({name: Figure()}, tmp_path / "figures")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ("../x", "/tmp/x", "a\\\\b", "..", " "))
def test_models_of_such_names_are_refused(name, tmp_path):
    file = tmp_path / "config.toml"
    file.write_text(f'[data]\nsystem = "pendulum"\n[models."{name}"]\n[models.b]\n', encoding="utf-8")
    with pytest.raises(bg.InputError, match="cannot name a model"):
        load_config(file)


def test_links_in_the_folder_are_replaced_and_not_followed(tmp_path):
    outside, folder = tmp_path / "precious.txt", tmp_path / "out"
    outside.write_text("mine", encoding="utf-8")
    folder.mkdir()
    (folder / "summary.json").symlink_to(outside)
    (folder / "page.png").symlink_to(outside)
    with staged(folder) as place:
        (place / "summary.json").write_text("results", encoding="utf-8")
    save_figures({"page": Figure()}, folder)
    assert outside.read_text(encoding="utf-8") == "mine"
    assert (folder / "summary.json").read_text(encoding="utf-8") == "results"
    assert not (folder / "page.png").is_symlink()


def test_a_saved_fit_replaces_a_link_too(tmp_path):
    outside = tmp_path / "precious.txt"
    outside.write_text("mine", encoding="utf-8")
    (tmp_path / "run.nc").symlink_to(outside)
    small(tmp_path / "run.nc")
    assert outside.read_text(encoding="utf-8") == "mine" and bg.load(tmp_path / "run.nc").model.equations == ("v",)
