"""Settings of a run of the sampler."""

from dataclasses import dataclass

from bayes_greybox.data.errors import InputError


@dataclass(frozen=True)
class Sampling:
    """Settings of a run.

    Attributes:
        draws: Draws kept in each chain.
        tune: Warm-up iterations of each chain.
        chains: Number of chains.
        seed: Seed of everything random in the run.
        target_accept: Target acceptance probability of NUTS.
        exact: Whether the draws are of the exact trajectory posterior (`Fit.refine`).
    """

    draws: int = 1000
    tune: int = 1000
    chains: int = 4
    seed: int = 0
    target_accept: float = 0.9
    exact: bool = False

    def __post_init__(self) -> None:
        for name in ("draws", "tune", "chains"):
            if getattr(self, name) < 1:
                raise InputError(f"{name}={getattr(self, name)} must be at least 1.")
        if not 0 < self.target_accept < 1:
            raise InputError(f"target_accept={self.target_accept:g} must lie between 0 and 1.")
