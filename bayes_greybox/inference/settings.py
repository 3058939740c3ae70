"""Settings of a run of the sampler."""

from dataclasses import dataclass
from numbers import Integral

from bayes_greybox.running.errors import InputError


@dataclass(frozen=True)
class Sampling:
    """Settings of a run, those of `GreyBox.fit`; `exact` draws are of the exact trajectory posterior (`Fit.refine`)."""

    draws: int = 1000
    tune: int = 1000
    chains: int = 4
    seed: int = 0
    target_accept: float = 0.9
    exact: bool = False

    def __post_init__(self) -> None:
        for name, least in {"draws": 1, "tune": 1, "chains": 1, "seed": 0}.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
                raise InputError(f"{name}={value!r} must be a whole number, at least {least}.")
        if not 0 < self.target_accept < 1:
            raise InputError(f"target_accept={self.target_accept:g} must lie between 0 and 1.")
