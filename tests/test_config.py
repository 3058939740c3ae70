import dataclasses
import inspect
import os
import subprocess
import sys
import typing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayes_greybox as bg
from bayes_greybox.config import load_config, parts, sources
from bayes_greybox.config.file import Compare, Sampling
from bayes_greybox.criticism.cross_validation.folds import SCHEMES
from bayes_greybox.data.datasets import FOLDER_VARIABLE
from bayes_greybox.model.gp.discrepancy import Path as PathKind
from bayes_greybox.model.gp.kernels import KERNELS, Measure, Variant
from bayes_greybox.model.priors import PRIORS
from bayes_greybox.model.rows.kinds import ROW_KINDS
from bayes_greybox.running.errors import InputError

CONFIGS = Path(__file__).parents[1] / "configs"

BASE = """
[data]
system = "oscillator"
t = { stop = 10.0, points = 60 }

[dictionary]
ydot = ["y", "ydot**3"]
"""

TABLE = """
[data]
path = "run.csv"
time = "t"
states = ["y", "ydot"]
derivatives = { ydot = "a" }
units = { y = "m", t = "s" }
"""

COEFFICIENTS = """
[coefficients.ydot]
y = { mean = -2, sd = 0.1 }
"ydot**3" = { sign = -1 }
"""

DICTIONARY = '\n[dictionary]\nydot = ["y"]\n'


def write(folder: Path, text: str, name: str = "case.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def config(folder: Path, text: str):
    return load_config(write(folder, text))


def table(folder: Path, n: int = 40, name: str = "run.csv") -> pd.DataFrame:
    t = np.linspace(0.0, 6.0, n)
    frame = pd.DataFrame({"t": t, "y": np.sin(t), "ydot": np.cos(t), "a": -np.sin(t)})
    frame.to_csv(folder / name, index=False)
    return frame


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            BASE + '[discrepancy]\nvarient = "none"',
            "[discrepancy] unknown key 'varient'; did you mean 'variant'?",
        ),
        (BASE + "[dicrepancy]\nseed = 1", "unknown key 'dicrepancy'; did you mean 'discrepancy'?"),
        (BASE + '[models.a]\nprio = "x"', "[models.a] unknown key 'prio'; did you mean 'prior'?"),
        (
            BASE + '[models.a.prior]\nkind = "laplace"\nscal = 2',
            "[models.a.prior] unknown key 'scal'; did you mean 'scale'?",
        ),
        (BASE + '[prior]\nkind = "normal"\nzzz = 1', "[prior] unknown key 'zzz'; known: kind, scale."),
        (
            BASE + '[prior]\nkind = "laplase"',
            "[prior] kind = 'laplase' is not available; did you mean 'laplace'?",
        ),
        (BASE + "[prior]\nkind = [1]", "[prior] kind = [1] is not available; known: spike_and_slab, laplace, "),
        (BASE + "[discrepancy]\nkernel = 3", "[discrepancy] kernel = 3 is not available; known: squared_exponential, "),
        ("discrepancy = 3\n" + BASE, "discrepancy = 3 cannot be used; it must be a table of keys and values."),
        (BASE + "[study]\nodds = 3", "[study] odds = 3 cannot be used; it must be a table of keys and values."),
        (BASE + "[discrepancy]\nboundary = 1.0", "[discrepancy] boundary = 1.0 must exceed 1, the edge of"),
        (BASE + "[discrepancy]\nvariables = 'y'", "[discrepancy] variables = 'y' cannot be used; it must be a list."),
        (BASE + "[prior]\nscale = 1.0", "[prior] needs the key 'kind'; known: spike_and_slab, laplace, "),
        ('prior = "laplace"\n' + BASE, "prior = 'laplace' should be a table with the key kind"),
        (
            BASE + '[discrepancy]\nvariant = "projcted"',
            "[discrepancy] variant = 'projcted' is not available; did you mean 'projected'?",
        ),
        (
            BASE + "[discrepancy]\nfeatures = [8, 0]",
            "[discrepancy] features = [8, 0] should be a positive whole",
        ),
        (
            BASE + "[sampling]\ndraws = 0",
            "[sampling] draws = 0 cannot be used; it must be greater than or equal",
        ),
        (
            BASE + '[sampling]\ndraws = "9"',
            "[sampling] draws = '9' cannot be used; it must be a whole number.",
        ),
        (
            BASE + "[sampling]\ndraws = true",
            "[sampling] draws = True cannot be used; it must be a whole number.",
        ),
        (
            BASE + '[output]\nfigures = "no"',
            "[output] figures = 'no' cannot be used; it must be true or false.",
        ),
        (
            BASE + '[prior]\nkind = "normal"\nscale = nan',
            "[prior] scale = nan cannot be used; it must be a finite",
        ),
        (BASE + "[simulation]\ny = 3", "[simulation] y = 3 cannot be used; it must be text in quotes."),
        (BASE + "ydot2 = [1]", "[dictionary.ydot2] terms[0] = 1 cannot be used; it must be a table"),
        (BASE + '[models."a/b"]', "[models] 'a/b' cannot name a model, because files are named after it."),
        (
            BASE + '[models.a]\n[models.b]\ndictionary = { y = "y" }',
            "[models] a learns ydot but b learns y; compare models of the same equations.",
        ),
        ("[dictionary]\nydot = 'y'", "needs the key 'data'."),
        (BASE + "[study]\ncatalog = 'fluid'", "[study] unknown key 'catalog'; did you mean 'catalogue'?"),
        (BASE + "[study]\ncatalogue = [1]", "[study] catalogue = [1] should be the name of a catalogue in quotes"),
        (BASE + "[study]\nroles = { input = 3 }", "[study.roles] input = 3 should be the name of a column in quotes"),
        (BASE + "[study]\nodds = { no_gap = 1.5 }", "[study.odds] no_gap = 1.5 cannot be used; it must be less than 1"),
        (BASE + "[study]\neffects_at_most = 0", "[study] effects_at_most = 0 cannot be used; it must be greater"),
        (TABLE.replace('states = ["y", "ydot"]', "") + DICTIONARY, "[data] needs the key 'states'."),
        (
            TABLE.replace('["y", "ydot"]', '"y"') + DICTIONARY,
            "[data] states = 'y' should be a list of column names",
        ),
        (TABLE + 'system = "duffing"' + DICTIONARY, "[data] should be a table with exactly one of path"),
        ("[data]" + DICTIONARY, "[data] should be a table with exactly one of path"),
        (BASE.replace("stop", "stpo"), "[data.t] unknown key 'stpo'; did you mean 'stop'?"),
        (
            BASE.replace('"oscillator"', '"oscilator"'),
            "[data] system = 'oscilator' is not available; did you mean 'oscillator'?",
        ),
        (
            BASE.replace('"oscillator"', '"oscillator"\nx0 = ["a"]'),
            "[data] x0 = ['a'] should be a list of numbers",
        ),
        (
            BASE.replace('"oscillator"', '"oscillator"\ntest_fraction = 0.2\ntest = { seed = 1 }'),
            "[data] give either test_fraction or the table test, not both.",
        ),
        (
            BASE.replace('"oscillator"', '"oscillator"\nsplit_by = "time"'),
            "[data] split_by needs test_fraction, the share of the data to hold out.",
        ),
        (BASE + "[compare]\nstart = 0.7", '[compare] start applies to scheme = "future" only; leave it out.'),
        (
            BASE + "[models.a]\n[models.b]\ndictionary = {}",
            "[models] a learns ydot but b learns ; compare models of the same equations.",
        ),
    ],
)
def test_a_wrong_file_is_refused_with_the_place_and_the_remedy(tmp_path, text, sentence):
    with pytest.raises(InputError) as error:
        config(tmp_path, text)
    message = str(error.value)
    assert message.startswith(f'"{tmp_path / "case.toml"}": {sentence}')
    assert "\n" not in message and message.endswith((".", "?"))


def test_all_mistakes_are_told_at_once(tmp_path):
    text = BASE.replace("stop", "stpo") + '[prior]\nkind = "laplase"\n[rows]\n[sampling]\ndraws = 0\nchain = 2\n'
    with pytest.raises(InputError) as error:
        config(tmp_path, text + '[dicrepancy]\nkernel = "x"')
    said = [
        "unknown key 'dicrepancy'; did you mean 'discrepancy'?",
        "[data.t] unknown key 'stpo'; did you mean 'stop'?",
        "[data.t] needs the key 'stop'.",
        "[prior] kind = 'laplase' is not available; did you mean 'laplace'?",
        "[rows] needs the key 'kind'; known: ",
        "[sampling] unknown key 'chain'; did you mean 'chains'?",
        "[sampling] draws = 0 cannot be used; ",
    ]
    message = str(error.value)
    places = [message.index(each) for each in said]
    assert places == sorted(places) and message.count("Also: ") == len(said) - 1


def test_mistakes_are_told_without_the_rooms_of_models_where_no_section_needs_them(tmp_path):
    path = write(tmp_path, BASE + "[sampling]\ndraws = 0")
    program = f"""
import sys
from bayes_greybox.config import load_config
try:
    load_config({str(path)!r})
except ValueError as error:
    print(error, "jax" in sys.modules, "numpy" in sys.modules)
"""
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert "[sampling] draws = 0 cannot be used" in told and told.endswith("False False\n")


def test_malformed_toml_is_refused_with_its_line(tmp_path):
    with pytest.raises(InputError, match=r"is not valid TOML: .*line 4"):
        config(tmp_path, "[data]\ntime = 't'\nstates = [\n = 3")


def test_files_that_are_no_configuration_are_refused(tmp_path):
    with pytest.raises(InputError, match="There is no configuration file"):
        load_config(tmp_path / "absent.toml")
    with pytest.raises(InputError, match="cannot be read"):
        load_config(tmp_path)
    (tmp_path / "bytes.toml").write_bytes(b"a = '\xff'")
    with pytest.raises(InputError, match=r"not UTF-8 text \(at byte 5\)"):
        load_config(tmp_path / "bytes.toml")


def test_what_a_file_leaves_out_has_the_default_of_the_package(tmp_path):
    model = config(tmp_path, BASE).build_model()
    default = bg.GreyBox({"ydot": ["y"]})
    assert (model.prior, model.discrepancy) == (default.prior, default.discrepancy)
    assert (model.noise_floor, model.noise) == (default.noise_floor, default.noise)
    assert config(tmp_path, BASE + '[prior]\nkind = "regularised_horseshoe"').build_model().prior == (
        bg.RegularisedHorseshoe()
    )


@pytest.mark.parametrize(
    "table",
    [
        *(f"[prior]\nkind = '{kind}'" for kind in PRIORS),
        *(f"[rows]\nkind = '{kind}'" for kind in ROW_KINDS),
        "[discrepancy]",
        "[study]\nodds = {",
    ],
)
def test_every_field_of_a_class_is_a_key_of_its_table(tmp_path, table):
    section, own = _section(config(tmp_path, BASE + table + (" }" if table.endswith("{") else "")))
    part = section.build()
    assert set(type(section).model_fields) - own == {field.name for field in dataclasses.fields(part)}
    # What the file leaves out has the default of the class.
    assert part == type(part)()
    defaults = {name: value for name, value in dataclasses.asdict(part).items() if value is not None}
    again = _section(config(tmp_path, BASE + _written(table, defaults)))[0]
    assert again.build() == part


def _section(settings):
    """The one section of a file that is a class of the package's, and its keys that are not fields of the class."""
    for section, own in (
        (settings.prior, {"kind"}),
        (settings.rows, {"kind"}),
        (settings.discrepancy, {"enabled"}),
        (settings.study.odds, set()),
    ):
        if section is not None:
            return section, own
    raise AssertionError


def _written(table, fields):
    def value(given):
        # TOML has lists where classes have tuples.
        plain = list(given) if isinstance(given, tuple) else given
        return f"{plain!r}".lower() if not isinstance(given, str) else f'"{given}"'

    pairs = [f"{name} = {value(given)}" for name, given in fields.items()]
    return f"{table} {', '.join(pairs)} }}" if table.endswith("{") else "\n".join([table, *pairs])


def test_choices_are_those_of_the_package(tmp_path):
    for field, known in (("variant", Variant), ("measure", Measure), ("path", PathKind)):
        for choice in set(typing.get_args(known)) - {"printed"}:
            text = BASE + f'[discrepancy]\n{field} = "{choice}"'
            assert getattr(config(tmp_path, text).build_model().discrepancy, field) == choice
    for name in KERNELS:
        assert config(tmp_path, BASE + f'[discrepancy]\nkernel = "{name}"').build_model().discrepancy.kernel == name
    with pytest.raises(InputError, match=r"\[discrepancy\] kernel = 'matern' is not available; did you mean 'matern"):
        config(tmp_path, BASE + '[discrepancy]\nkernel = "matern"')
    assert set(typing.get_args(Compare.model_fields["scheme"].annotation)) == set(SCHEMES)
    systems = {name for name in bg.systems.__all__ if inspect.isfunction(getattr(bg.systems, name))}
    assert set(typing.get_args(sources.SystemSource.model_fields["system"].annotation)) == systems - {"multisine"}


def test_sampling_has_the_defaults_of_the_package():
    arguments = inspect.signature(bg.GreyBox.fit).parameters
    for name, field in Sampling.model_fields.items():
        assert arguments[name].default == field.default


def test_a_study_has_the_arguments_and_defaults_of_the_package():
    arguments = dict(inspect.signature(bg.find_missing_effects).parameters)
    # Where draws are kept is said by [output] and --resume.
    own = set(arguments) - {"model", "train", "test", "progress", "checkpoint", "checkpoint_every", "resume"}
    assert set(parts.Study.model_fields) | set(Sampling.model_fields) - {"target_accept"} == own
    for name, field in parts.Study.model_fields.items():
        assert arguments[name].default == field.default or (name == "roles" and field.default == {})


def test_a_study_passes_on_only_what_the_file_says(tmp_path):
    text = BASE + '[study]\ncatalogue = ["all", "own.toml"]\nodds = { effects = 0.2 }\nsettle = false'
    arguments = config(tmp_path, text).study_arguments()
    assert arguments.pop("odds") == bg.Odds(effects=0.2)
    assert arguments == {
        "catalogue": ["all", str(tmp_path / "own.toml")],
        "settle": False,
        **Sampling().model_dump(exclude={"target_accept"}),
    }
    assert "catalogue" not in config(tmp_path, BASE).study_arguments()
    assert config(tmp_path, BASE + "[study]\ncatalogue = []").study_arguments()["catalogue"] == []


def test_a_study_needs_no_dictionary_but_a_fit_does(tmp_path):
    text = BASE.split("[dictionary]")[0] + '[simulation]\nydot = "-y"'
    settings = config(tmp_path, text)
    assert dict(settings.build_studied_model().dictionary) == {}
    with pytest.raises(InputError, match=r"has no \[dictionary\].*bayes-greybox discover"):
        settings.build_model()
    with pytest.raises(InputError, match="has neither"):
        config(tmp_path, BASE.split("[dictionary]")[0]).build_studied_model()


def test_data_of_a_system_are_those_of_the_direct_call(tmp_path):
    text = BASE.replace('"oscillator"', '"oscillator"\nparameters = { c = 0.3 }\nnoise = 0.05\nseed = 7')
    text += "[data.test]\nseed = 8\nx0 = { y = 0.5, ydot = 0.1 }\n"
    train, test = config(tmp_path, text).read_data()
    t = np.linspace(0.0, 10.0, 60)
    system = bg.systems.oscillator(c=0.3)
    pd.testing.assert_frame_equal(train.to_frame(), system.simulate(t, noise=0.05, seed=7).to_frame())
    expected = system.simulate(t, noise=0.05, seed=8, x0=[0.5, 0.1])
    pd.testing.assert_frame_equal(test.to_frame(), expected.to_frame())


def test_parameters_that_a_system_lacks_are_refused(tmp_path):
    text = BASE.replace('"oscillator"', '"oscillator"\nparameters = { m = 1.0 }')
    with pytest.raises(InputError, match=r"\[data.parameters\] oscillator has no parameter 'm'; it has c, k"):
        config(tmp_path, text).read_data()


def test_a_table_is_found_beside_the_file_and_split_contiguously(tmp_path, monkeypatch):
    frame = table(tmp_path)
    settings = config(tmp_path, TABLE + "test_fraction = 0.25" + DICTIONARY)
    monkeypatch.chdir("/")
    train, test = settings.read_data()
    assert (train.n_obs, test.n_obs) == (30, 10)
    # pandas 2 may read the last digit of a number one off.
    np.testing.assert_allclose(np.concatenate([train.time, test.time]), frame["t"], rtol=1e-15)
    np.testing.assert_allclose(train.derivatives["ydot"], frame["a"][:30], rtol=1e-15)
    assert train.units == {"y": "m", "t": "s"}


def test_a_test_table_has_the_columns_of_the_training_table(tmp_path):
    table(tmp_path)
    held_out = table(tmp_path, 15, "later.csv")
    train, test = config(tmp_path, TABLE + 'test = { path = "later.csv" }' + DICTIONARY).read_data()
    assert train.n_obs == 40
    np.testing.assert_allclose(test.states["y"], held_out["y"], rtol=1e-15)


def test_a_table_may_have_outputs_and_no_states(tmp_path):
    frame = table(tmp_path)
    text = '[data]\npath = "run.csv"\ntime = "t"\nstates = []\ninputs = ["y"]\noutputs = { R = "a" }\n'
    train, _ = config(tmp_path, text + '[dictionary]\nR = ["y"]\n').read_data()
    assert train.state_names == () and train.output_names == ("R",)
    np.testing.assert_allclose(train.rate("R"), frame["a"], rtol=1e-15)


def test_the_table_of_a_file_has_every_option_of_read_under_its_name():
    options = dict(inspect.signature(bg.read).parameters)
    own = set(sources.TableSource.model_fields) - set(sources.Source.model_fields) - {"path", "trajectory"}
    # What rows in chunks have beside, and nothing that `stream` does not take.
    streamed = set(sources.STREAMED) - {"path", "trajectory", "stream", "test"}
    assert streamed == set(inspect.signature(bg.stream).parameters) - {"source"}
    own -= {"stream", *sources.STREAMING}
    assert own - {"test"} == set(options) - {"source"}
    for name in own - {"states", "test"}:
        default = sources.TableSource.model_fields[name].default
        assert (default or None) == (options[name].default or None)


def test_a_table_is_read_through_the_same_door(tmp_path):
    frame = table(tmp_path)
    for number in (1, 2):
        frame.to_csv(tmp_path / f"part{number}.csv", index=False, sep=";", decimal=",")
    text = '[data]\npath = "part*.csv"\ntime = "t"\nstates = ["y"]\ndecimal = ","\nrates = { y = "v" }\n'
    train, test = config(tmp_path, text + "test_fraction = 0.25" + DICTIONARY).read_data()
    assert train.run_names == test.run_names == ("part1", "part2") and train.derivative_names == ("y", "v")
    listed = text.replace('"part*.csv"', '["part2.csv"]')
    assert config(tmp_path, listed + DICTIONARY).read_data()[0].run_names == ("part2",)
    with pytest.raises(InputError, match="rates stands in"):
        config(tmp_path, text + 'differentiate = { rates = { y = "w" } }\n' + DICTIONARY)
    with pytest.raises(InputError, match="two names of one key"):
        config(tmp_path, text + 'run = "id"\ntrajectory = "id"\n' + DICTIONARY)


def test_no_test_data_means_none(tmp_path):
    table(tmp_path)
    assert config(tmp_path, TABLE + DICTIONARY).read_data()[1] is None


def test_both_parts_are_differentiated_after_the_split(tmp_path):
    t = np.linspace(0.0, 20.0, 400)
    pd.DataFrame({"t": t, "y": np.sin(t)}).to_csv(tmp_path / "run.csv", index=False)
    text = """
    [data]
    path = "run.csv"
    time = "t"
    states = ["y"]
    test_fraction = 0.5

    [data.differentiate]
    rates = { y = "v" }
    window = 21
    """
    train, test = config(tmp_path, text + '\n[dictionary]\nv = ["y"]').read_data()
    # Each part loses the edges of its own filter, so no row of one has seen a sample of the other.
    assert train.n_obs == test.n_obs == 200 - 20
    np.testing.assert_allclose(test.derivatives["v"], -np.sin(test.time), atol=1e-3)


def test_a_wrong_part_of_a_data_set_is_refused_with_the_parts(tmp_path, monkeypatch):
    monkeypatch.setattr("bayes_greybox.data.datasets.load_dataset", lambda name, **options: {"train": None})
    text = '[data]\ndataset = "silverbox"\npart = "trian"' + DICTIONARY
    with pytest.raises(InputError, match="'silverbox' has no part 'trian'; set part to one of train"):
        config(tmp_path, text).read_data()
    with pytest.raises(InputError, match="'silverbox' comes in parts; set part to one of train"):
        config(tmp_path, text.replace('part = "trian"', "")).read_data()


def test_a_model_is_what_its_sections_say(tmp_path):
    text = (
        BASE
        + """
    z = { polynomial = { variables = ["y"], degree = 2 }, terms = [{ expression = "sin(2*y)", name = "s" }] }

    [simulation]
    ydot = "-y"

    [prior]
    kind = "regularised_horseshoe"
    slab_scale = 3.0

    [discrepancy]
    variant = "conditioned"
    variables = ["y"]
    features = [12]

    [noise]
    floor = 1e-3
    """
    )
    model = config(tmp_path, text).build_model()
    assert model.prior == bg.RegularisedHorseshoe(slab_scale=3.0)
    assert model.discrepancy == bg.OrthogonalGP(variant="conditioned", variables=("y",), features=(12,))
    assert [term.name for term in model.dictionary["ydot"]] == ["y", "ydot**3"]
    assert [term.name for term in model.dictionary["z"]] == ["y", "y**2", "s"]
    assert model.simulation == {"ydot": "-y"}
    assert (model.noise_floor, model.noise) == (1e-3, 1.0)


def test_noise_of_a_fit_is_read_with_its_options(tmp_path):
    text = BASE + '\n[noise]\nscale = 0.5\nforce = "fit"\ntails = 4.0\n'
    assert config(tmp_path, text).build_model().noise == bg.Noise(scale=0.5, force="fit", tails=4.0)
    with pytest.raises(InputError, match="force"):
        config(tmp_path, BASE + "\n[noise]\nforce = 2.0\n")


def test_models_replace_sections_of_the_base(tmp_path):
    text = (
        BASE
        + """
    [prior]
    kind = "laplace"

    [discrepancy]
    variant = "conditioned"

    [models]
    base = {}
    normal = { prior = { kind = "normal" } }
    parametric = { discrepancy = { enabled = false }, dictionary = { ydot = "y" } }
    """
    )
    settings = config(tmp_path, text)
    base, normal, parametric = (settings.build_model(name) for name in settings.models)
    assert (base.prior, base.discrepancy.variant) == (bg.Laplace(), "conditioned")
    assert (normal.prior, normal.discrepancy) == (bg.Normal(), base.discrepancy)
    assert (parametric.prior, parametric.discrepancy) == (bg.Laplace(), None)
    assert [term.name for term in parametric.dictionary["ydot"]] == ["y"]
    with pytest.raises(InputError, match="There is no model 'x'; there are base, normal, parametric"):
        settings.build_model("x")


def test_overrides_are_checked_like_the_file(tmp_path):
    settings = config(tmp_path, BASE + "[sampling]\ndraws = 5\nseed = 3")
    changed = settings.with_settings("sampling", draws=7, seed=None)
    assert (changed.sampling.draws, changed.sampling.seed) == (7, 3)
    assert (changed.text, changed.folder) == (settings.text, Path("runs/case"))
    with pytest.raises(InputError, match="chains = 0 cannot be used"):
        settings.with_settings("sampling", chains=0)


def test_the_bundled_table_is_the_one_that_its_comment_makes():
    made = bg.systems.oscillator().simulate(np.linspace(0.0, 99.75, 400), noise=0.02, seed=1)
    columns = {"t": made.time, **made.states, "a": made.derivatives["ydot"]}
    bundled = pd.read_csv(CONFIGS / "data" / "oscillator.csv")
    assert list(bundled.columns) == list(columns)
    for name, values in columns.items():
        np.testing.assert_allclose(bundled[name], values, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_file_says_what_it_shows_and_builds_data_and_models(path):
    settings = load_config(path)
    assert settings.text.startswith("# ")
    if "dataset" in settings.data.model_fields_set and not os.environ.get(FOLDER_VARIABLE):
        pytest.skip(f"{FOLDER_VARIABLE} does not name the folder of the benchmark data")
    train, _ = settings.read_data()
    if not settings.dictionary:
        settings.build_studied_model()
        assert settings.study_arguments()["seed"] == settings.sampling.seed
        return
    for name in (None, *settings.models):
        model = settings.build_model(name)
        data = model.complete(train)
        assert set(model.dictionary) <= set(data.derivatives)
        # Units and names of every term fit the data.
        model.dictionaries(data)


def test_priors_of_single_coefficients_are_read(tmp_path):
    model = load_config(write(tmp_path, BASE + COEFFICIENTS)).build_model()
    coefficient = bg.priors.Coefficient
    assert model.coefficients == {
        "ydot": {"y": coefficient(mean=-2.0, sd=0.1), "ydot**3": coefficient(sign=-1)},
    }
    other = '\n[models.free]\ncoefficients = {}\n[models.told]\nprior = { kind = "normal" }\n'
    config = load_config(write(tmp_path, BASE + COEFFICIENTS + other))
    assert config.build_model("free").coefficients == {}
    assert config.build_model("told").coefficients == model.coefficients


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("y = { sgn = 1 }", r"\[coefficients\.ydot\.y\] unknown key 'sgn'; did you mean 'sign'"),
        ("y = { sign = 3 }", r"sign = 3 must be 1 or -1"),
        ("y = { mean = 1.0, sd = -1.0 }", r"sd = -1\.0 must be a finite number above 0"),
        ("y = -2.0", r"table"),
    ],
)
def test_a_prior_of_a_coefficient_that_cannot_be_used_is_named(tmp_path, line, said):
    with pytest.raises(InputError, match=said):
        load_config(write(tmp_path, f"{BASE}\n[coefficients.ydot]\n{line}\n"))


def test_a_prior_of_a_coefficient_that_says_two_things_is_refused_when_the_model_is_built(tmp_path):
    text = f"{BASE}\n[coefficients.ydot]\ny = {{ fixed = 1.0, sign = 1 }}\n"
    with pytest.raises(InputError, match="says two things"):
        load_config(write(tmp_path, text)).build_model()


STATING = "ydot = ['y', { expression = 'y**3', %s }]"


@pytest.mark.parametrize(
    ("said", "stated"),
    [
        ('sign = "-", prior = [-40, 10.0]', {"mean": -40.0, "sd": 10.0, "sign": -1}),
        ("fixed = 2", {"fixed": 2.0}),
        ("bounds = [-1.5, 3]", {"lower": -1.5, "upper": 3.0}),
    ],
)
def test_terms_may_state_their_coefficients(tmp_path, said, stated):
    base = BASE.split("[dictionary]")[0] + "[dictionary]\n"
    expected = {"ydot": {"y**3": bg.priors.Coefficient(**stated)}}
    assert config(tmp_path, base + STATING % said).build_model().coefficients == expected
    listed = f"[dictionary.ydot]\nterms = {(STATING % said).split(' = ', 1)[1]}"
    assert config(tmp_path, base.replace("[dictionary]\n", listed)).build_model().coefficients == expected


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ('sign = "plus"', r"\[dictionary\.ydot\.terms\[1\]\] sign = 'plus' is not available; known: \+, -"),
        ("prior = [1.0]", r"prior = \[1\.0\] must be mean and standard deviation of the coefficient"),
        ("prior = [1.0, -1.0]", "above 0"),
        ("bounds = [0.0, inf]", "use lower or upper of \\[coefficients\\]"),
        ("bounds = [2.0, 1.0]", "wrong way round"),
        ("fixed = nan", "finite number"),
        ('fixed = 1.0, sign = "+"', r"terms\[1\]\] The term 'y\*\*3' has fixed=1 and sign='\+'"),
        ('sign = "-", prior = [40.0, 10.0]', "mean is not possible with sign='-'"),
        ('sgn = "+"', "unknown key 'sgn'; did you mean 'sign'"),
    ],
)
def test_what_a_term_cannot_state_is_named_with_its_place(tmp_path, said, why):
    with pytest.raises(InputError, match=why):
        config(tmp_path, BASE.split("[dictionary]")[0] + "[dictionary]\n" + STATING % said)


@pytest.mark.parametrize("key", ["rates", "differentiate = { rates"])
def test_a_measured_rate_is_not_computed(tmp_path, key):
    table(tmp_path)
    columns = pd.read_csv(tmp_path / "run.csv").columns
    settings = f'[data]\npath = "run.csv"\ntime = "{columns[0]}"\nstates = ["{columns[1]}"]\n'
    rates = f'{key} = {{ {columns[1]} = "{columns[2]}" }}{" }" if "{" in key else ""}\n'
    with pytest.raises(InputError, match=f'"{columns[2]}" was not measured, but .*run.csv" has that column'):
        config(tmp_path, settings + rates + DICTIONARY).read_data()
