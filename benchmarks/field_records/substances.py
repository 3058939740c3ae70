"""Substances that are given to patients by infusion, and their concentration in the blood."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .record import INSTRUMENT, NAMED, NO_GAP, ONE_OF, PARTLY, RECALIBRATE, UNKNOWN, FieldRecord, Measured
from .signals import held, levels, path

ELIMINATION = 0.2
"""Rate of elimination as it is written down, 1/h."""

FEW = np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0])
MORE = np.array([0, 0.5, 1, 1.5, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24.0])
"""Hours of a patient's blood samples."""

GIVEN = 0.5
"""Time in which the dose that nobody recorded is given, h."""


@dataclass(frozen=True)
class Substance:
    """c' = u − elimination + production + exchange (z − c); hours and mg/l.

    Attributes:
        k: Rate of elimination in proportion, 1/h.
        saturable: Rate of elimination at low concentrations, 1/h, and the concentration of half of it, which take the
            place of k; None keeps it.
        tissue: Exchange with a second compartment, 1/h, and its time, h.
        production: Rate of production, mg/(l h).
        unrecorded: Time and size of a dose that nobody recorded.
        late: Time by which the infusion acts late, h.
    """

    k: float = ELIMINATION
    saturable: tuple[float, float] | None = None
    tissue: tuple[float, float] | None = None
    production: float = 0.0
    unrecorded: tuple[float, float] | None = None
    late: float = 0.0


@dataclass(frozen=True)
class Assay:
    """Relative error of a concentration, its noise, and the limit below which it is reported as zero, mg/l."""

    error: float = 0.1
    noise: float = 0.0
    limit: float = 0.0


def concentration(each: Substance, t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the concentration in the blood at the times t; the infusion is held from sample to sample."""
    infusion, late, dose = held(t, u), each.late, each.unrecorded

    def rates(time: float, x: np.ndarray) -> list[float]:
        eliminated = each.k * x[0]
        if each.saturable:
            eliminated = each.saturable[0] * x[0] / (1 + x[0] / each.saturable[1])
        c = infusion(time - late) * (time >= late) - eliminated + each.production
        if dose and dose[0] <= time < dose[0] + GIVEN:
            c += dose[1] / GIVEN
        if not each.tissue:
            return [c, 0.0]
        return [c + each.tissue[0] * (x[1] - x[0]), (x[0] - x[1]) / each.tissue[1]]

    jumps = [time + late for time in t] + ([dose[0], dose[0] + GIVEN] if dose else [])
    return path(rates, [0.0, 0.0], t, jumps)[:, 0]


def measured(
    rng: np.random.Generator, t: np.ndarray, u: np.ndarray, each: Substance | None = None, assay: Assay | None = None
) -> Measured:
    """Return the infusion of one patient, in mg/(l h), and the concentrations that the assay reads."""
    each, assay, n = each or Substance(), assay or Assay(), len(t)
    clean, error = concentration(each, t, u), assay.error
    c = clean * np.exp(error * rng.standard_normal(n) - error**2 / 2) + assay.noise * rng.standard_normal(n)
    if assay.limit:
        c = np.where(c < assay.limit, 0.0, c)
    units = {"t": "h", "c": "mg/l", "u": "mg/(l*h)"}
    return Measured(t, {"u": u}, units, {"c": "u - k*c"}, {"k": ELIMINATION}, states={"c": np.round(c, 3)})


def patients(runs: Sequence[Measured]) -> Measured:
    """Return several patients as runs of one record."""
    return replace(
        runs[0],
        time=[np.asarray(run.time) for run in runs],
        states={"c": [np.asarray(run.states["c"]) for run in runs]},
        inputs={"u": [np.asarray(run.inputs["u"]) for run in runs]},
    )


def _one_patient(rng: np.random.Generator, each: Substance | None = None) -> Measured:
    return measured(rng, FEW, np.where(FEW < 1, 8.0, 0.0), each)


def _three_patients(rng: np.random.Generator, each: Substance | None = None) -> Measured:
    return patients([measured(rng, FEW, np.where(FEW < 1, dose, 0.0), each) for dose in (4.0, 8.0, 16.0)])


def _below_the_limit(rng: np.random.Generator) -> Measured:
    t = np.arange(0, 30, 1.0)
    return measured(rng, t, np.where(t < 2, 4.0, 0.0), assay=Assay(0.07, limit=0.3))


def _tissue_and_enzyme(rng: np.random.Generator) -> Measured:
    t = np.arange(0, 36, 0.5)
    u = np.where((t < 2) | ((t >= 10) & (t < 12)) | ((t >= 20) & (t < 24)), 5.0, 0.0)
    return measured(rng, t, u, Substance(tissue=(0.4, 5.0), saturable=(0.5, 4.0)), Assay(0.06))


def _unrecorded_dose(rng: np.random.Generator) -> Measured:
    t = np.arange(0, 30, 0.5)
    return measured(rng, t, np.where(t < 2, 4.0, 0.0), Substance(unrecorded=(9.3, 5.0)), Assay(0.06))


def _late_infusion(rng: np.random.Generator) -> Measured:
    t = np.arange(0, 30, 0.5)
    u = np.where((t < 2) | ((t >= 12) & (t < 15)), 4.0, 0.0)
    return measured(rng, t, u, Substance(late=0.7), Assay(0.06))


def _repeated_infusions(rng: np.random.Generator) -> Measured:
    u = levels(rng, 200, [0, 0, 0, 2.0, 5.0], 4, 24)
    return replace(measured(rng, np.arange(200) * 0.25, u, assay=Assay(0.08, 0.02)), split=0.7)


def _people(rng: np.random.Generator) -> Measured:
    runs = []
    for dose in (4, 6, 8, 10, 12.0):
        each = Substance(k=0.2 * np.exp(0.2 * rng.standard_normal()))
        runs.append(measured(rng, MORE, np.where(MORE < 1, dose, 0.0), each, Assay(0.08)))
    return patients(runs)


def _enzyme(rng: np.random.Generator) -> Measured:
    each, assay = Substance(saturable=(0.2, 5.0)), Assay(0.08)
    doses = (2, 6, 12, 20, 30.0)
    return patients([measured(rng, MORE, np.where(MORE < 1, dose, 0.0), each, assay) for dose in doses])


def _small_and_several(rng: np.random.Generator) -> Measured:
    each = Substance(tissue=(0.08, 5.0), k=0.21, production=0.03)
    return measured(rng, np.arange(100) * 0.4, levels(rng, 100, [0, 0, 2.0, 4.0], 4, 16), each, Assay(0.06))


TISSUE = Substance(tissue=(0.6, 3.0))

RECORDS = (
    FieldRecord(
        "one_patient", "compartment", 301, "Nothing; 11 samples with a relative error of 10 %.", _one_patient, {NO_GAP}
    ),
    FieldRecord(
        "tissue_of_one_patient", "compartment", 302,
        "A second compartment; 11 samples with a relative error of 10 %.",
        lambda rng: _one_patient(rng, TISSUE), {NAMED, ONE_OF, UNKNOWN}, {"second-compartment"},
    ),
    FieldRecord(
        "below_the_limit", "compartment", 303,
        "Nothing; 30 samples with a relative error of 7 %, reported as 0 below 0.3 mg/l.",
        _below_the_limit, {NO_GAP}, errors={"clipping of c", "misreadings of c"},
    ),
    FieldRecord(
        "tissue_and_enzyme", "compartment", 304,
        "A second compartment, and elimination that saturates instead of k*c; 72 samples, 6 %, three doses.",
        _tissue_and_enzyme, {NAMED, ONE_OF, PARTLY, UNKNOWN}, {"second-compartment", "saturable-elimination"},
    ),
    FieldRecord(
        "unrecorded_dose", "compartment", 305, "A second dose at 9.3 h that nobody recorded; 60 samples, 6 %.",
        _unrecorded_dose, {UNKNOWN},
    ),
    FieldRecord(
        "late_infusion", "compartment", 306, "The infusion begins to act 0.7 h late; 60 samples, 6 %.",
        _late_infusion, {INSTRUMENT, ONE_OF}, harmless={"absorption"}, errors={"delay of u"},
    ),
    FieldRecord(
        "repeated_infusions", "compartment", 307,
        "Nothing; 200 samples of repeated infusions with a relative error of 8 %.",
        _repeated_infusions, {NO_GAP},
    ),
    FieldRecord(
        "different_people", "compartment", 308,
        "Nothing but people: five patients whose k differs by 20 %, 14 samples each, 8 %.",
        _people, {NO_GAP, RECALIBRATE, UNKNOWN},
    ),
    FieldRecord(
        "enzyme_at_five_doses", "compartment", 309,
        "Elimination that saturates instead of k*c; five doses, 14 samples each, 8 %.",
        _enzyme, {NAMED, ONE_OF}, {"saturable-elimination"}, {"second-order-elimination"},
    ),
    FieldRecord(
        "three_small_in_a_patient", "compartment", 310,
        "A weak second compartment, k 5 % larger and a production of 0.03 mg/(l h); 100 samples, 6 %.",
        _small_and_several, {PARTLY, UNKNOWN}, {"second-compartment", "constant-production", "linear-elimination"},
    ),
    FieldRecord(
        "three_patients", "compartment", 311, "Nothing; three patients of 11 samples with a relative error of 10 %.",
        _three_patients, {NO_GAP},
    ),
    FieldRecord(
        "tissue_of_three_patients", "compartment", 312,
        "A second compartment; three patients of 11 samples with a relative error of 10 %.",
        lambda rng: _three_patients(rng, TISSUE), {NAMED, ONE_OF, UNKNOWN}, {"second-compartment"},
    ),
)  # fmt: skip
"""Records of substances."""
