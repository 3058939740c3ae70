"""The schema that editors read agrees with the checker, which it is derived from."""

import json
import tomllib
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from test_config import BASE, TABLE, config

import bayes_greybox as bg
from bayes_greybox import cli
from bayes_greybox.config.schema import json_schema
from bayes_greybox.model.gp.kernels import KERNELS
from bayes_greybox.model.priors import PRIORS

CONFIGS = sorted((Path(__file__).parents[1] / "configs").glob("*.toml"))


@pytest.fixture(scope="module")
def schema():
    made = json_schema()
    Draft202012Validator.check_schema(made)
    return Draft202012Validator(made)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_shipped_file_keeps_to_it(schema, path):
    assert list(schema.iter_errors(tomllib.loads(path.read_text(encoding="utf-8")))) == []


GOOD = [
    BASE,
    TABLE + '[dictionary]\nydot = "y"',
    TABLE + '[dictionary]\nydot = [{ expression = "y", name = "spring" }, "ydot"]',
    TABLE + '[dictionary]\nydot = ["y", { expression = "y**3", sign = "-", prior = [-40, 10] }]',
    TABLE + '[dictionary]\nydot = ["y", { expression = "y**3", bounds = [-40, 10] }, { expression = "1", fixed = 2 }]',
    BASE + '[noise]\ncorrelation = "fit"\ntails = 4.0',
    BASE + '[simulation]\nydot = "-y"',
    BASE + '[simulation]\nfmu = "plant.fmu"\nstep = 0.001\n[simulation.parameters]\nm = 1',
    BASE + '[prior]\nkind = "laplace"\nscale = 0.5\n[rows]\nkind = "trajectory"\n[study.odds]\nno_gap = 0.5',
    BASE + '[next]\nsignals = ["hold"]\namplitudes = [1, 0.5]\nstarts = [{ y = 1, ydot = 0.5 }]\nthreshold = 0',
    BASE + '[parameters]\nm = { value = 2.0, sd = 0.1, lower = 0, unit = "kg" }\nk = 30\nc = 0.8',
    BASE + '[starts]\nz = 1.0\nw = "y"\n[rows]\nkind = "derivative"\ninterpolation = ["zoh", "linear"]',
    BASE + '[coefficients.ydot]\ny = { mean = -2, sd = 0.1 }\n[models.a]\nprior = { kind = "normal" }',
]
BAD = [
    BASE + "[next]\nbatch = 0",
    BASE + "[next]\namplitudes = [0.0]",
    BASE + "[next]\nsignal = ['hold']",
    BASE + '[discrepancy]\nvarient = "none"',
    BASE + "[sampling]\ndraws = 0",
    BASE + '[sampling]\ndraws = "9"',
    BASE + "[dicrepancy]\nseed = 1",
    BASE + '[prior]\nkind = "laplase"',
    BASE + "[prior]\nscale = 1.0",
    BASE + '[prior]\nkind = "laplace"\nscal = 1.0',
    BASE + '[discrepancy]\nkernel = "matern"',
    BASE + '[noise]\ncorrelation = "guess"',
    BASE + '[parameters]\nm = "2"',
    BASE + "[starts]\nz = [1.0, 0.1]",
    BASE + '[rows]\nkind = "trajectory"\ninterpolation = ["zoh", 3]',
    BASE + "[parameters]\nm = { value = 2.0, sd = 0 }",
    BASE + "[parameters]\nm = { value = 2.0, bounds = [0, 3] }",
    BASE + "[study]\nodds = { no_gap = 1.5 }",
    BASE.replace("oscillator", "oscilator"),
    TABLE.replace('["y", "ydot"]', '"y"'),
    TABLE + "skiprows = -1",
    TABLE + '[dictionary]\nydot = [{ expression = "y", sign = "plus" }]',
    TABLE + '[dictionary]\nydot = [{ expression = "y", prior = [1.0] }]',
    TABLE + '[dictionary]\nydot = [{ expression = "y", fixed = "1" }]',
    BASE + '[simulation]\nfmu = "plant.fmu"\nparametres = { m = 1 }',
    BASE + '[simulation]\nfmu = "plant.fmu"\nstep = -1',
    "[dictionary]\nydot = 'y'",
]


@pytest.mark.parametrize("text", GOOD)
def test_what_the_checker_takes_it_takes(schema, text, tmp_path):
    config(tmp_path, text)
    assert list(schema.iter_errors(tomllib.loads(text))) == []


@pytest.mark.parametrize("text", BAD)
def test_what_it_refuses_the_checker_refuses(schema, text, tmp_path):
    with pytest.raises(bg.InputError):
        config(tmp_path, text)
    assert list(schema.iter_errors(tomllib.loads(text)))


def test_choices_are_those_of_the_registries_and_nothing_is_null(schema):
    properties = schema.schema["properties"]
    assert [each["properties"]["kind"]["const"] for each in properties["prior"]["oneOf"]] == list(PRIORS)
    assert properties["discrepancy"]["properties"]["kernel"]["enum"] == list(KERNELS)
    assert "null" not in json.dumps(schema.schema)


def test_the_command_prints_it(schema, capsys):
    assert cli.main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == schema.schema
