"""[next]: what could be measured next, and how it is ranked."""

from bayes_greybox.running.limits import Count, NotNegative, Positive

from .section import Section


class Next(Section):
    """[next]: arguments of `Study.next_experiment`; options of the command next go before them.

    Attributes:
        sensors: Standard deviation of the noise by channel.
        starts: States at the start, each a table of values by name.
    """

    signals: list[str] | None = None
    amplitudes: list[Positive] | None = None
    starts: list[dict[str, float]] | None = None
    sensors: dict[str, Positive] | None = None
    duration: Positive | None = None
    rows: Count | None = None
    batch: Count | None = None
    threshold: NotNegative | None = None
    outcomes: Count | None = None
