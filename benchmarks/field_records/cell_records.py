"""Records of battery cells."""

from dataclasses import replace

import numpy as np

from .cells import PULSES, Cell, Sensors, hysteresis, measured, open_voltage, pulses, regular, relaxation, sampled
from .record import INSTRUMENT, NAMED, NO_GAP, PARTLY, RECALIBRATE, UNKNOWN, FieldRecord, Measured
from .signals import levels


def _uneven_with_gaps(rng: np.random.Generator) -> Measured:
    t, gaps = np.arange(0, 1500, 0.5), ((300, 400), (700, 860), (1100, 1180))
    i = levels(rng, len(t), PULSES, 20, 120)
    for begin, end in gaps:
        i[(t >= begin - 4) & (t < end + 4)] = 0.0
    kept, k = np.zeros(len(t), bool), 0
    while k < len(t):
        kept[k] = True
        k += int(rng.integers(1, 9)) + (8 if rng.random() < 0.05 else 0)
    for begin, end in gaps:
        kept[(t > begin) & (t < end)] = False
    return measured(rng, sampled(kept, t, i))


def _current_in_gaps(rng: np.random.Generator) -> Measured:
    t = np.arange(0, 1500, 1.0)
    i = levels(rng, len(t), PULSES, 10, 60)
    kept = (np.arange(len(t)) % 2 == 0) & ~((t > 400) & (t < 560)) & ~((t > 800) & (t < 900))
    i[(t > 400) & (t < 560)] = 4.0
    return measured(rng, sampled(kept, t, i))


def _one_discharge(rng: np.random.Generator) -> Measured:
    t = np.arange(700) * 2.0
    current = regular(np.where(t < 800, 2.5, np.where(t < 1000, 0.0, -1.2)))
    return measured(rng, current, sensors=Sensors(current_noise=0.0, voltage_noise=0.0, voltage_step=5 / 4096))


def _warming(rng: np.random.Generator) -> Measured:
    warm = Cell(extra=lambda t, i, soc: 0.05 * 0.3 * (1 - np.exp(-t / 600)) * i)
    return measured(rng, pulses(rng), warm)


def _with_hysteresis(rng: np.random.Generator) -> Measured:
    current = regular(levels(rng, 900, [-3.0, -1.5, 0.0, 0.0, 2.0, 4.0], 15, 60))
    return measured(rng, current, Cell(extra=hysteresis(0.020, 60.0), start=0.7))


def _uneven_relaxation(rng: np.random.Generator) -> Measured:
    fine_t = np.arange(0, 1500, 1.0)
    fine_i = levels(rng, len(fine_t), PULSES, 10, 60)
    fine_i[(fine_t >= 590) & (fine_t < 815)] = 0.0
    drop = relaxation(0.015, 40.0)(fine_t, fine_i, fine_t)
    kept, k = np.zeros(len(fine_t), bool), 0
    while k < len(fine_t):
        kept[k] = True
        k += int(rng.integers(1, 7))
    kept[(fine_t > 600) & (fine_t < 800)] = False
    cell = Cell(extra=lambda t, i, soc: np.interp(t, fine_t, drop))
    return measured(rng, sampled(kept, fine_t, fine_i), cell)


def _small_and_several(rng: np.random.Generator) -> Measured:
    cell = Cell(capacity=2.425, extra=relaxation(0.006, 20.0))
    return measured(rng, pulses(rng), cell, Sensors(current_offset=0.02))


def _plateau(rng: np.random.Generator) -> Measured:
    cell = Cell(curve=lambda soc: open_voltage(soc) + 0.012 * np.tanh((soc - 0.8) / 0.02))
    return measured(rng, pulses(rng, 900), cell)


def _late_voltage(rng: np.random.Generator) -> Measured:
    made = measured(rng, pulses(rng, 701))
    late = {"time": made.time[:-1], "inputs": {"i": made.inputs["i"][1:]}, "outputs": {"V": made.outputs["V"][:-1]}}
    return replace(made, **late)


RECORDS = (
    FieldRecord(
        "quiet_cell", "battery", 101, "Nothing; V in steps of 1 mV with noise of 0.7 mV, i of 12 bits.",
        lambda rng: measured(rng, pulses(rng)), {NO_GAP},
    ),
    FieldRecord(
        "noisy_current", "battery", 102, "Nothing; the current has noise of 60 mA, and V feels the true current.",
        lambda rng: measured(rng, pulses(rng), sensors=Sensors(current_noise=0.06)), {NO_GAP, INSTRUMENT},
    ),
    FieldRecord(
        "uneven_cell", "battery", 103,
        "Nothing; samples are 0.5 to 8 s apart, the current switches between them, and is at rest in three gaps.",
        # Unknown is the honest answer where the charge counted from samples is not the true one.
        _uneven_with_gaps, {NO_GAP, UNKNOWN},
    ),
    FieldRecord(
        "current_in_gaps", "battery", 104, "Nothing; regular samples, but two gaps in which the current went on.",
        _current_in_gaps, {NO_GAP, UNKNOWN},
    ),
    FieldRecord(
        "one_discharge", "battery", 105,
        "Nothing; one long discharge, rest and charge; V in steps of 1.22 mV without other noise.",
        _one_discharge, {NO_GAP},
    ),
    FieldRecord(
        "current_offset", "battery", 106, "The sensor of the current reads 60 mA too much.",
        lambda rng: measured(rng, pulses(rng), sensors=Sensors(current_offset=0.06)), {INSTRUMENT},
        errors={"offset of i"},
    ),
    FieldRecord(
        "aged_cell", "battery", 107, "The capacity is 5 % smaller than Q.",
        # A state of charge that is off by more and more looks like a drift of the voltage, which is honest.
        lambda rng: measured(rng, pulses(rng, 900), Cell(capacity=2.375)), {RECALIBRATE, UNKNOWN, INSTRUMENT},
        errors={"drift of V"},
    ),
    FieldRecord(
        "warming_cell", "battery", 108, "R0 falls by 30 % as the cell warms up, in 600 s.",
        _warming, {RECALIBRATE, UNKNOWN},
    ),
    FieldRecord(
        "cell_hysteresis", "battery", 109, "The open-circuit voltage has a hysteresis of 20 mV, driven by charge.",
        _with_hysteresis, {UNKNOWN},
    ),
    FieldRecord(
        "uneven_relaxation", "battery", 110,
        "A relaxation of 15 mΩ and 40 s; samples are 1 to 6 s apart, with a gap of 200 s at rest.",
        _uneven_relaxation, {NAMED}, {"relaxation"}, {"two-relaxations"},
    ),
    FieldRecord(
        "three_small_in_a_cell", "battery", 111,
        "A relaxation of 6 mΩ and 20 s; the capacity is 3 % smaller than Q; the current reads 20 mA too much.",
        _small_and_several, {NAMED, PARTLY}, {"relaxation"}, {"two-relaxations"}, {"offset of i"},
    ),
    FieldRecord(
        "plateau", "battery", 112, "The open-circuit voltage has a step of 12 mV in soc that the simulation lacks.",
        _plateau, {UNKNOWN},
    ),
    FieldRecord(
        "late_voltage", "battery", 113, "V is logged one sample, 2 s, after i.",
        # One of the two clocks is off, and only their difference is seen.
        _late_voltage, {INSTRUMENT}, errors={"delay of V", "delay of i"},
    ),
)  # fmt: skip
"""Records of cells."""
